"""What stands right in front of a camera goes, and so does what no training camera sees."""

from dataclasses import replace

import numpy as np
import torch

from gsynopsis.config import Joint
from gsynopsis.model.anchors import AnchorModel
from gsynopsis.model.build import model_to_levels
from gsynopsis.training.levels.selection import prune_unseen_slots
from gsynopsis.training.phases.full import FullPhase
from gsynopsis.training.phases.joint import JointPhase
from gsynopsis.training.regularize.floaters import NEAR, floaters
from gsynopsis.training.state import TrainState, fresh_state, set_model
from tests.tiny import tiny_config, tiny_model, tiny_scene
from tests.training.test_loop import context

SCENE = tiny_scene()
CAMERA = SCENE.views[SCENE.train[0]].camera
THING = 2.5
"""The nearest points of the scene are about so far from its cameras."""


def planted(*places: np.ndarray) -> AnchorModel:
    """A model whose first anchors stand at these places."""
    model = tiny_model()
    lattice = model.lattice.clone()
    for row, place in enumerate(places):
        lattice[row] = torch.from_numpy(np.rint(place / model.frame.voxel).astype(np.int64))
    model.set_lattice(lattice)
    return model


def before(depth: float, aside: float = 0.0) -> np.ndarray:
    """A place at a depth before the camera, and aside."""
    right = CAMERA.w2c[0, :3]
    return CAMERA.position + depth * CAMERA.forward + aside * right


def test_an_anchor_right_before_a_camera_is_a_floater_and_others_are_not() -> None:
    near, far = 0.5 * NEAR * THING, 2 * NEAR * THING
    model = planted(before(near), before(far), before(-2.0), before(near, aside=far))
    assert floaters(model, SCENE).nonzero()[:, 0].tolist() == [0]


def test_cameras_with_few_points_do_not_judge_and_something_always_stays() -> None:
    model = planted(before(0.1))
    few = replace(SCENE, points=SCENE.points[:20], colors=SCENE.colors[:20])
    assert not floaters(model, few).any()
    model = planted(*[before(0.1)] * len(model))
    assert not floaters(model, SCENE).any()


def test_floaters_are_pruned_when_the_full_training_ends_and_are_in_no_level() -> None:
    state = fresh_state(context(tiny_config(prune_share=0.0036)))
    model = planted(before(0.1))
    cell = model.lattice[0].tolist()
    set_model(state, model)
    FullPhase(30, 50).end(state)
    assert state.model.part(-1).mask.any(dim=1).logical_not().nonzero()[:, 0].tolist() == [0]
    levels = state.context.config.levels
    assert isinstance(levels, Joint)
    JointPhase(levels, 30).begin(state)
    written = model_to_levels(state.model, {})
    assert cell not in written.shared.lattice.tolist()


def test_what_no_training_camera_sees_is_dropped_and_their_pictures_stay() -> None:
    state = fresh_state(context())
    behind = CAMERA.position - 3 * CAMERA.forward
    set_model(state, planted(behind))
    pictures = drawn(state)
    prune_unseen_slots(state)
    assert not state.model.part(-1).mask[0].any()
    assert state.model.part(-1).mask.any()
    for one, other in zip(pictures, drawn(state), strict=True):
        assert torch.equal(one, other)


def drawn(state: TrainState) -> list[torch.Tensor]:
    scene, model = state.context.scene, state.model
    cameras = [scene.camera(view) for view in scene.train]
    with torch.no_grad():
        return [
            state.context.renderer.render(model.decode(c), c, state.background).image
            for c in cameras
        ]
