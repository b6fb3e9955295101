// The table of one variant's hot functions.
#include "stages.hpp"

namespace gsyn {
namespace GSYN_VARIANT {

extern const Kernels kernels = {
    project,           blend,            blend_backward, blend_removal, project_backward,
    hashgrid_forward,  hashgrid_backward, cull,          activate,      assemble,
    assemble_backward, loss_patch,       adam,           choose,        heads_forward,
    heads_backward};

}  // namespace GSYN_VARIANT
}  // namespace gsyn
