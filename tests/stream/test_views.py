import numpy as np
import pytest

from gsynopsis.stream.views import LEAK, ViewPose, covered, extrapolate


def eye_at(x: float, turn: float = 0.0) -> ViewPose:
    w2c = np.eye(4)
    c, s = np.cos(turn), np.sin(turn)
    w2c[:3, :3] = [[c, 0, -s], [0, 1, 0], [s, 0, c]]
    w2c[:3, 3] = -w2c[:3, :3] @ np.array([x, 0.0, 0.0])
    return ViewPose(w2c, 0.5, 0.5)


def boxes(*centres: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    middle = np.array(centres, np.float64)
    return middle - 0.5, middle + 0.5


def test_a_camera_that_sees_no_box_has_no_shares() -> None:
    assert covered(*boxes((0, 0, -5), (0, 0, -9)), eye_at(0)).tolist() == [0, 0]


def test_what_is_behind_or_beside_has_only_the_leak() -> None:
    low, high = boxes((0, 0, 5), (0, 0, -5), (20, 0, 5))
    for x, seen in ((0, 0), (20, 2)):
        found = covered(low, high, eye_at(x))
        others = np.delete(found, seen)
        assert found[seen] == pytest.approx(1 - 2 * LEAK / 3)
        assert others == pytest.approx(LEAK / 3)


def test_shares_sum_to_one_and_fall_with_the_square_of_distance() -> None:
    found = covered(*boxes((-1, 0, 10), (2, 0, 20)), eye_at(0))
    assert found.sum() == pytest.approx(1)
    assert found[0] / found[1] == pytest.approx(4, rel=0.05)


@pytest.mark.parametrize("time", [0.0, 0.5, 3.0])
def test_a_steady_motion_goes_on(time: float) -> None:
    before, now = eye_at(0.0, 0.0), eye_at(0.1, 0.02)
    (found,) = extrapolate(before, now, 0.1, [time])
    expected = eye_at(0.1 + time, 0.02 + 0.2 * time)
    assert found.w2c == pytest.approx(expected.w2c, abs=1e-9)


def test_a_camera_at_rest_stays() -> None:
    (found,) = extrapolate(eye_at(1), eye_at(1), 0.1, [9.0])
    assert found.w2c == pytest.approx(eye_at(1).w2c)


def test_what_a_box_covers_follows_its_size_and_what_of_it_is_in_the_picture() -> None:
    low, high = boxes((0, 0, 10), (0, 0, 20), (0, 0, -10), (10, 0, 10))
    near, far, behind, edge = covered(low, high, eye_at(0))
    assert near > 3 * far > 30 * behind
    assert near > edge
    assert near + far + behind + edge == pytest.approx(1)
    assert behind == pytest.approx(LEAK / 4)


def test_a_box_around_the_camera_covers_the_picture() -> None:
    low, high = np.array([[-50.0] * 3, [30.0, 30, 5]]), np.array([[50.0] * 3, [31.0, 31, 6]])
    assert covered(low, high, eye_at(0))[0] > 0.95
