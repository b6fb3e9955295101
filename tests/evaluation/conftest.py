import pytest

from gsynopsis.evaluation.evaluate import evaluate
from gsynopsis.evaluation.protocols import Options
from gsynopsis.evaluation.report import Provenance, Report
from tests.stage import LevelDecoder, fake_scene, level_set, renderer_of


@pytest.fixture(scope="session")
def report() -> Report:
    scene = fake_scene()
    provenance = Provenance("standard", 7, 2400, 83.25, "every8")
    options = Options(frames=2, warmup=0, pictures=2, provenance=provenance)
    decoder = LevelDecoder((0.2, 0.1, 0.04, 0.0))
    return evaluate(decoder, level_set(), scene, renderer_of(scene), 1.0, options)
