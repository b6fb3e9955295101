"""Choice of whole steps on a WebGPU device, and why not."""

from gsynopsis.config import Joint
from gsynopsis.render.webgpu.renderer import WebGpuRenderer
from gsynopsis.training.context import TrainContext
from gsynopsis.training.webgpu.step import WebGpuStep


def whole_step(context: TrainContext) -> WebGpuStep | None:
    """Whole steps on the renderer's device; None: it is another one, or a kernel is missing."""
    renderer = context.renderer
    if not isinstance(renderer, WebGpuRenderer) or left_to_host(context):
        return None
    return WebGpuStep(renderer.gpu, context.scene.cache.budget)


def left_to_host(context: TrainContext) -> str:
    """Reasons why a training has no whole steps on a device, in a few words; empty: it has.

    Then only images and their gradients are the device's.
    """
    config = context.config
    model = config.model
    reasons = {
        "several processes": context.group.size > 1,
        "a block of a scene": context.region is not None,
        "levels one after the other": not isinstance(config.levels, Joint),
        "a fusion MLP": model.fusion == "mlp" and model.feature == "synopsis",
    }
    return ", ".join(name for name, there in reasons.items() if there)
