"""The arm as a node of reservoirpy and as a transformer of scikit-learn."""

import numpy as np
import pytest
from documents import code_blocks, run_python
from octoarm_agents.analysis.drive import Drive, record_arm
from octoarm_agents.analysis.nodes import ArmNode, ArmTransformer
from reservoirpy.nodes import Ridge
from sklearn.base import clone
from sklearn.exceptions import NotFittedError
from sklearn.linear_model import Ridge as LinearRidge
from sklearn.model_selection import GridSearchCV, TimeSeriesSplit
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from octoarm_env import ArmParameters

VALUES = np.random.default_rng(0).uniform(-1, 1, (60, 1))


def _lengths(**drive) -> np.ndarray:
    return record_arm(ArmParameters(), Drive(**drive), VALUES[:, 0]).states


def test_a_node_gives_the_driven_arm_in_one_run_or_many() -> None:
    expected = _lengths(hold=0.02)
    node = ArmNode(drive=Drive(hold=0.02))
    assert np.array_equal(node.run(VALUES), expected)
    node.reset()
    parts = [node.run(VALUES[:20]), [node(row) for row in VALUES[20:25]], node.run(VALUES[25:])]
    assert np.array_equal(np.concatenate(parts), expected)


def test_a_node_forgets_nothing_of_another_series() -> None:
    node = ArmNode()
    both = node.run(np.stack((VALUES, -VALUES)))
    fresh = ArmNode()
    assert np.array_equal(both[0], fresh.run(VALUES))
    fresh.reset()
    assert np.array_equal(both[1], fresh.run(-VALUES))


def test_a_model_of_the_node_and_a_ridge_repeats_the_input() -> None:
    values = np.random.default_rng(1).uniform(-1, 1, (400, 1))
    node = ArmNode()
    lengths = node.run(values)
    centre, scale = lengths.mean(axis=0), lengths.std(axis=0)
    readout = Ridge(ridge=1e-6)
    readout.fit((lengths[100:300] - centre) / scale, values[100:300])
    said = readout.run((lengths[300:] - centre) / scale)
    assert np.mean((said - values[300:]) ** 2) < 0.1 * values[300:].var()
    assert (node >> Ridge(ridge=1e-6)).fit(values, values, warmup=100).run(values).shape == (400, 1)


def test_a_transformer_gives_the_driven_arm() -> None:
    arm = ArmTransformer(hold=0.02)
    with pytest.raises(NotFittedError):
        arm.transform(VALUES)
    assert np.array_equal(arm.fit_transform(VALUES), _lengths(hold=0.02))
    assert clone(arm).get_params() == {"arm": None, "amplitude": 20.0, "hold": 0.02}


def test_a_search_varies_the_arm() -> None:
    delayed = np.concatenate(([0.0], VALUES[:-1, 0]))
    pipe = make_pipeline(ArmTransformer(), StandardScaler(), LinearRidge(1e-6))
    grid = {"armtransformer__hold": [0.01, 0.05], "armtransformer__arm": ["nakajima2013"]}
    search = GridSearchCV(pipe, grid, cv=TimeSeriesSplit(2)).fit(VALUES, delayed)
    assert search.best_params_["armtransformer__hold"] in (0.01, 0.05)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.zeros((3, 2)), "input of 2 features: expected 1, the drive's value"),
        (np.full((3, 1), 1.5), r"input up to 1\.5: expected values in \[-1, 1\]"),
    ],
)
def test_what_cannot_be_is_refused(values, message: str) -> None:
    for take in (ArmNode().run, ArmTransformer().fit):
        with pytest.raises(ValueError, match=message):
            take(values)


def test_a_drive_that_cannot_be_is_refused_at_fit() -> None:
    with pytest.raises(ValueError, match=r"amplitude = -1: expected 0 to 360 degrees"):
        ArmTransformer(amplitude=-1).fit(VALUES)


def test_the_page_of_clients(tmp_path) -> None:
    code = code_blocks("docs/clients.md", "python")[-1]
    assert run_python(code, tmp_path) == code_blocks("docs/clients.md", "text")[-1]
