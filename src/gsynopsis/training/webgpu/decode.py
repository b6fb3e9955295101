"""Anchors to Gaussians on the device, and gradients back: culling, heads, assembly.

Letters: N anchors, V of them visible, K slots, G Gaussians, H hidden units of a head.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from gsynopsis.model.anchors import AnchorModel, LevelPart
from gsynopsis.model.encoding import all_corners
from gsynopsis.records import HEAD_NAMES, VIEW_INPUTS
from gsynopsis.render.webgpu.device import Buffer, Gpu
from gsynopsis.render.webgpu.rasterizer import GAUSSIAN, view_of
from gsynopsis.scene.camera import Camera
from gsynopsis.training.webgpu.resident import Resident, live_bits

OUTPUTS = (1, 7, 3)
"""Outputs a slot of the heads for opacity, covariance and colour."""
PART, PARTS = 256, 256
"""Rows summed by one invocation at least, and parts at most."""


@dataclass(frozen=True)
class DecodedView:
    """Gaussians and anchors of a part in a view, on the device.

    Attributes:
        rows: Visible anchors, uint32 [V].
        visible: V.
        inputs: Of the heads, float32 [V, W].
        width: W.
        hidden: After ReLU, float32 [V, 3H].
        raw: Outputs of the heads, float32 [V, 11K]: opacity K, covariance 7K, colour 3K.
        places: Of each anchor the number of visible ones before it, uint32 [N + 1].
        codes: Codebook rows of visible anchors, uint32 [V], where there is a codebook.
        starts: Of each slot the number of drawn slots before it, uint32 [V·K + 1].
        count: G.
        gaussians: float32 [G, 14].
    """

    rows: Buffer
    visible: int
    inputs: Buffer
    width: int
    hidden: Buffer
    raw: Buffer
    places: Buffer
    codes: Buffer
    starts: Buffer
    count: int
    gaussians: Buffer


def decode_view(held: Resident, model: AnchorModel, part: LevelPart, camera: Camera) -> DecodedView:
    """Queue the Gaussians of a part that a camera sees; V and G are read on the way."""
    gpu, count, slots = held.gpu, len(model), model.slots
    tables = _tables(held, model, part)
    (live,) = held.derived(part.mask, {"live": live_bits})
    places, rows = gpu.scratch(count + 1), gpu.scratch(count)
    buffers = [*tables[:3], live, tables[3], places]
    view = view_of(camera, 0.0, 0.0)
    gpu.run("cull", count + 1, buffers, count=count, slots=slots, **view)
    gpu.scan(places, count + 1)
    gpu.run("compact", count, [places, rows], count=count)
    visible = int(gpu.read(places, np.uint32, 1, count)[0])

    inputs, width = _head_inputs(held, model, part, camera, rows, visible)
    codes = _choose_codes(held, model, part, rows, visible, inputs)
    hidden, raw = _heads(held, model, part, inputs, visible)
    known = {"count": visible, "slots": slots}
    starts = gpu.scratch(visible * slots + 1)
    gpu.run("mark_drawn", visible * slots + 1, [rows, live, raw, starts], **known)
    gpu.scan(starts, visible * slots + 1)
    drawn = int(gpu.read(starts, np.uint32, 1, visible * slots)[0])
    gaussians = gpu.scratch(drawn * GAUSSIAN, f"{drawn:,} Gaussians")
    gpu.run("assemble", visible * slots, [rows, starts, raw, *tables, gaussians], **known)
    made = (inputs, width, hidden, raw, places, codes, starts, drawn, gaussians)
    return DecodedView(rows, visible, *made)


def decode_backward(
    held: Resident,
    model: AnchorModel,
    part: LevelPart,
    view: DecodedView,
    grads: Buffer,
    pulls: tuple[float, float],
) -> None:
    """Queue the gradients of a part's and the model's parameters; they add up in `held`.

    Args:
        held: Gradients of those that want one.
        model: The model.
        part: The part that was decoded.
        view: What `decode_view` made.
        grads: Of the Gaussians, float32 [G, 16].
        pulls: Further gradients of each product of three scales, and of each opacity.
    """
    if view.visible == 0:
        return
    gpu, slots, count = held.gpu, model.slots, view.visible
    stride = sum(OUTPUTS) * slots + 3
    of_outputs = gpu.scratch(count * stride)
    _, *tables = _tables(held, model, part)
    buffers = [view.rows, view.starts, view.raw, grads, *tables, of_outputs]
    buffers += [held.grad(model.log_scales), held.grad(model.offsets)]
    known = {"count": count, "slots": slots, "volume": pulls[0], "opacity": pulls[1]}
    gpu.run("assemble_backward", count, buffers, **known)
    if part.log_gain.requires_grad:
        _column_sums(gpu, of_outputs, count, stride, held.grad(part.log_gain))
    _heads_backward(held, model, part, view, of_outputs)


def _tables(held: Resident, model: AnchorModel, part: LevelPart) -> list[Buffer]:
    """Positions, log scales, offsets and level scale."""
    positions, _ = model.placed()
    return [held.of(t) for t in (positions, model.log_scales, model.offsets, part.log_gain)]


def _columns(model: AnchorModel, part: LevelPart) -> tuple[int, int, int]:
    """Inputs of the heads from grids, codebook and residual."""
    return part.grids * model.layout.features, part.codebook.shape[1], model.residual.shape[1]


def _head_inputs(
    held: Resident,
    model: AnchorModel,
    part: LevelPart,
    camera: Camera,
    rows: Buffer,
    visible: int,
) -> tuple[Buffer, int]:
    """Inputs of the heads [V, W] but for the codebook's, and W."""
    gpu, (grids, chosen, residual) = held.gpu, _columns(model, part)
    first = grids + chosen
    width = first + residual + VIEW_INPUTS
    inputs = gpu.scratch(visible * width)
    if chosen and not part.codebook.shape[0]:
        gpu.clear(inputs)
    if grids:
        corners, weights, *_ = _grid_tables(held, model)
        buffers = [rows, corners, weights, held.of(model.table), inputs]
        known = _grid_numbers(model, part, width)
        gpu.run("grid_inputs", visible * grids, buffers, count=visible, **known)
    view = model.view_input(camera)
    x, y, z = view.position
    buffers = [rows, held.of(model.placed()[0]), held.of(model.residual), inputs]
    gpu.run(
        *("head_inputs", visible, buffers),
        count=visible,
        stride=width,
        first=first,
        residual=residual,
        x=x,
        y=y,
        z=z,
        extent=view.extent,
        low=view.low,
        high=min(view.high, 3e38),
    )
    return inputs, width


def _choose_codes(
    held: Resident,
    model: AnchorModel,
    part: LevelPart,
    rows: Buffer,
    visible: int,
    inputs: Buffer,
) -> Buffer:
    """Codebook rows [V], whose values go into the inputs; a codebook of no rows reads as zeros."""
    gpu, (grids, chosen, residual) = held.gpu, _columns(model, part)
    entries = part.codebook.shape[0]
    codes = gpu.scratch(visible)
    if entries and chosen:
        buffers = [rows, held.of(model.logits), held.of(model.codes), held.of(part.codebook)]
        known = {"entries": entries, "width": chosen, "frozen": int(not model.logits.shape[1])}
        stride = grids + chosen + residual + VIEW_INPUTS
        buffers += [codes, inputs]
        gpu.run(
            *("choose_code", visible, buffers), count=visible, stride=stride, first=grids, **known
        )
    return codes


def _grid_numbers(model: AnchorModel, part: LevelPart, stride: int) -> dict[str, int]:
    layout = model.layout
    sizes = {"levels": part.grids, "all_levels": len(layout.sizes), "features": layout.features}
    return sizes | {"stride": stride}


def _grid_tables(held: Resident, model: AnchorModel) -> list[Buffer]:
    """Table rows and weights of all corners, [N, L, 8] each; where rows begin, corners by row."""
    layout = model.layout

    def rows_of(u: Tensor) -> NDArray[np.uint32]:
        return all_corners(u, layout)[0].numpy().astype(np.uint32).reshape(-1)

    def starts_of(u: Tensor) -> NDArray[np.uint32]:
        counts = np.bincount(rows_of(u), minlength=layout.rows)
        return np.concatenate([[0], np.cumsum(counts)]).astype(np.uint32)

    tables = {
        "corners": rows_of,
        "weights": lambda u: all_corners(u, layout)[1].float().numpy(),
        "starts": starts_of,
        "order": lambda u: np.argsort(rows_of(u), kind="stable").astype(np.uint32),
    }
    return held.derived(model.placed()[1], tables)


def _heads(
    held: Resident, model: AnchorModel, part: LevelPart, inputs: Buffer, visible: int
) -> tuple[Buffer, Buffer]:
    """Hidden units [V, 3H] and outputs [V, 11K]."""
    gpu, slots = held.gpu, model.slots
    wide, width = part.networks["opacity_w1"].shape
    hidden, raw = gpu.scratch(visible * 3 * wide), gpu.scratch(visible * sum(OUTPUTS) * slots)
    first = 0
    for number, (head, each) in enumerate(zip(HEAD_NAMES, OUTPUTS, strict=True)):
        w1, b1, w2, b2 = (held.of(part.networks[f"{head}_{n}"]) for n in ("w1", "b1", "w2", "b2"))
        gpu.run(
            *("linear", visible * wide, [w1, b1, inputs, hidden]),
            count=visible,
            inputs=width,
            outputs=wide,
            relu=1,
            in_stride=width,
            in_first=0,
            out_stride=3 * wide,
            out_first=number * wide,
        )
        gpu.run(
            *("linear", visible * each * slots, [w2, b2, hidden, raw]),
            count=visible,
            inputs=wide,
            outputs=each * slots,
            relu=0,
            in_stride=3 * wide,
            in_first=number * wide,
            out_stride=sum(OUTPUTS) * slots,
            out_first=first,
        )
        first += each * slots
    return hidden, raw


def _heads_backward(
    held: Resident, model: AnchorModel, part: LevelPart, view: DecodedView, of_outputs: Buffer
) -> None:
    gpu, slots, count, width = held.gpu, model.slots, view.visible, view.width
    wide, stride = part.networks["opacity_w1"].shape[0], sum(OUTPUTS) * slots + 3
    of_hidden, of_inputs = gpu.scratch(count * 3 * wide), gpu.scratch(count * width)
    first = 0
    for number, (head, each) in enumerate(zip(HEAD_NAMES, OUTPUTS, strict=True)):
        names = [f"{head}_{n}" for n in ("w1", "b1", "w2", "b2")]
        w1, b1, w2, b2 = (part.networks[name] for name in names)
        gpu.run(
            *("linear_back", count * wide, [held.of(w2), of_outputs, view.hidden, of_hidden]),
            count=count,
            inputs=wide,
            outputs=each * slots,
            relu=1,
            add=0,
            of_stride=stride,
            of_first=first,
            to_stride=3 * wide,
            to_first=number * wide,
        )
        gpu.run(
            *("linear_back", count * width, [held.of(w1), of_hidden, view.inputs, of_inputs]),
            count=count,
            inputs=width,
            outputs=wide,
            relu=0,
            add=number,
            of_stride=3 * wide,
            of_first=number * wide,
            to_stride=width,
            to_first=0,
        )
        at, inside = (stride, first), (3 * wide, number * wide)
        if w2.requires_grad:
            shape = (each * slots, wide)
            pair = held.grad(w2), held.grad(b2)
            _layer_sums(gpu, (of_outputs, *at), (view.hidden, *inside), count, shape, pair)
        if w1.requires_grad:
            shape = (wide, width)
            pair = held.grad(w1), held.grad(b1)
            _layer_sums(gpu, (of_hidden, *inside), (view.inputs, width, 0), count, shape, pair)
        first += each * slots
    _features_backward(held, model, part, view, of_inputs)


def _features_backward(
    held: Resident, model: AnchorModel, part: LevelPart, view: DecodedView, pulls: Buffer
) -> None:
    """Queue the gradients of residual, codebook, logits and grids, from those of the inputs."""
    gpu, (grids, chosen, residual), count = held.gpu, _columns(model, part), view.visible
    entries, stride = part.codebook.shape[0], view.width
    if residual and model.residual.requires_grad:
        known = {"width": residual, "stride": stride, "first": grids + chosen}
        buffers = [view.rows, pulls, held.grad(model.residual)]
        gpu.run("add_rows", count * residual, buffers, count=count, **known)
    places = {"count": count, "stride": stride, "first": grids}
    if entries and chosen and part.codebook.requires_grad:
        size, part_rows = entries * chosen, max(PART, -(-count // PARTS))
        parts = -(-count // part_rows)
        sums, known = gpu.scratch(parts * size), {"entries": entries, "width": chosen}
        buffers = [view.codes, pulls, sums]
        gpu.run("codebook_sums", parts * size, buffers, part=part_rows, **known, **places)
        buffers = [sums, gpu.scratch(1), held.grad(part.codebook)]
        gpu.run("add_parts", size, buffers, parts=parts, inputs=0, outputs=size)
    if entries and chosen and model.logits.numel() and model.logits.requires_grad:
        buffers = [view.rows, held.of(model.logits), held.of(part.codebook), pulls]
        buffers.append(held.grad(model.logits))
        known = {"entries": entries, "width": chosen}
        gpu.run("logits_backward", count, buffers, **known, **places)
    if grids and model.table.requires_grad:
        _, weights, starts, order = _grid_tables(held, model)
        rows, known = model.layout.rows, _grid_numbers(model, part, stride)
        buffers = [starts, order, weights, view.places, pulls, held.grad(model.table)]
        gpu.run("grid_backward", rows * model.layout.features, buffers, rows=rows, **known)


def _layer_sums(
    gpu: Gpu,
    pulls: tuple[Buffer, int, int],
    given: tuple[Buffer, int, int],
    count: int,
    shape: tuple[int, int],
    grads: tuple[Buffer, Buffer],
) -> None:
    """Queue the gradients of a layer's weights and bias; pulls and inputs with stride and first."""
    outputs, inputs = shape
    part = max(PART, -(-count // PARTS))
    parts = -(-count // part)
    partials = gpu.scratch(parts * outputs * (inputs + 1))
    gpu.run(
        *("outer_sums", parts * outputs * (inputs + 1), [pulls[0], given[0], partials]),
        count=count,
        inputs=inputs,
        outputs=outputs,
        part=part,
        of_stride=pulls[1],
        of_first=pulls[2],
        in_stride=given[1],
        in_first=given[2],
    )
    known = {"parts": parts, "inputs": inputs, "outputs": outputs}
    gpu.run("add_parts", outputs * (inputs + 1), [partials, *grads], **known)


def _column_sums(gpu: Gpu, of_outputs: Buffer, count: int, stride: int, grad: Buffer) -> None:
    """Queue the sums of the last three columns: a layer without inputs, whose bias they are."""
    pulls = (of_outputs, stride, stride - 3)
    _layer_sums(gpu, pulls, (gpu.scratch(1), 0, 0), count, (3, 0), (gpu.scratch(1), grad))
