// The Python face of the native kernels.
#include <nanobind/nanobind.h>

namespace nb = nanobind;

NB_MODULE(_core, m) {
    m.doc() = "Native kernels of gsynopsis.";
}
