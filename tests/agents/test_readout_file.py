"""A readout's file: exact, readable, bound to its body, and refused when it is not whole."""

import json

import numpy as np
import pytest
from octoarm_agents.reservoir import Readout, load_readout, save_readout

import octoarm_env
from octoarm_env import ArmParameters

BODY = ArmParameters(compartments=3)
PROTOCOL = {"target": "quadratic", "amplitude": 40.0, "steps": [100, 20], "note": "ν, R"}


def fitted(outputs=2, **settings):
    random = np.random.default_rng(0)
    lengths = 0.02 + 1e-3 * random.standard_normal((200, 12))
    targets = random.standard_normal((200, outputs) if outputs else 200)
    return Readout(**settings).fit(lengths, targets), lengths


@pytest.fixture
def path(tmp_path):
    """A good file."""
    file = tmp_path / "readout.json"
    save_readout(file, fitted()[0], parameters=BODY, protocol=PROTOCOL, seed=7)
    return file


def change(path, edit):
    """Let `edit` change the file's content."""
    content = json.loads(path.read_text(encoding="utf-8"))
    edit(content)
    path.write_text(json.dumps(content), encoding="utf-8")


@pytest.mark.parametrize("outputs", [0, 1, 2, 5])
@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"method": "ridge", "ridge": np.float64(1e-5), "bias": True, "tolerance": 1e-9},
        {"method": "noise", "noise": 1e-5, "sampled": True, "random_state": 3, "washout": 20},
    ],
    ids=["pinv", "ridge", "noise"],
)
def test_what_was_saved_is_loaded_to_the_bit(tmp_path, settings, outputs):
    readout, lengths = fitted(outputs, **settings)
    save_readout(tmp_path / "r.json", readout, parameters=BODY, protocol=PROTOCOL, seed=7)
    saved = load_readout(str(tmp_path / "r.json"), parameters=BODY)
    loaded = saved.readout
    assert loaded.get_params() == readout.get_params()
    for name in ("weights_", "coef_", "intercept_", "singular_values_"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(readout, name))
    for name in ("rank_", "training_error_", "single_output_", "n_features_in_"):
        assert getattr(loaded, name) == getattr(readout, name)
    np.testing.assert_array_equal(loaded.predict(lengths), readout.predict(lengths))
    assert saved.parameters == BODY
    assert saved.protocol == PROTOCOL
    assert saved.seed == 7
    assert saved.format == 1
    assert saved.versions["octoarm-env"] == octoarm_env.__version__
    # A loaded readout is saved again as the same file.
    save_readout(tmp_path / "s.json", loaded, parameters=BODY, protocol=PROTOCOL, seed=7)
    assert (tmp_path / "s.json").read_bytes() == (tmp_path / "r.json").read_bytes()


def test_the_file_says_what_it_is(path):
    content = json.loads(path.read_text(encoding="utf-8"))
    assert content["format"] == "octoarm-readout"
    assert content["version"] == 1
    assert content["settings"]["method"] == "pinv"
    assert content["body"]["compartments"] == 3
    assert np.shape(content["weights"]) == (12, 2)
    assert list(path.parent.iterdir()) == [path]


def test_another_body_is_refused_by_its_parameters(path):
    other = BODY.replace(arm_density=BODY.arm_density + 1, gravity=(0.0, 1.0, 0.0))
    with pytest.raises(ValueError, match="another body") as caught:
        load_readout(path, parameters=other)
    message = str(caught.value)
    assert str(path) in message
    assert f"arm_density is {BODY.arm_density} in the file and {other.arm_density} where" in message
    assert "gravity is" in message
    assert "compartments" not in message
    assert load_readout(path).parameters == BODY


def test_a_file_cut_short_anywhere_is_refused(path):
    whole = path.read_bytes().rstrip()
    for end in range(0, len(whole), max(1, len(whole) // 100)):
        path.write_bytes(whole[:end])
        with pytest.raises(ValueError, match=r"readout\.json is not a complete JSON file"):
            load_readout(path)


@pytest.mark.parametrize(
    "damage", [b"\xff\xfe\x00", b"[" * 100_000, b'{"format": NaN}', b"\x80\x04\x95 pickle"]
)
def test_other_bytes_are_refused(path, damage):
    path.write_bytes(damage)
    with pytest.raises(ValueError, match=r"readout\.json is not a complete JSON file"):
        load_readout(path)


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda c: c.update(format="other"), "not a readout file"),
        (lambda c: c.update(version=2), "version = 2: this release reads version 1"),
        (lambda c: c.update(version=True), "version = True"),
        (lambda c: c.pop("weights"), "weights is missing"),
        (lambda c: c.pop("protocol"), "protocol is missing"),
        (lambda c: c.update(body=[1.0]), "body is of type list, expected dict"),
        (lambda c: c.update(seed="seven"), "seed is of type str, expected int"),
        (lambda c: c["weights"].pop(), r"weights have shape \(11, 2\), expected \(12, outputs\)"),
        (lambda c: c["weights"][3].pop(), "weights: .*inhomogeneous"),
        (lambda c: c["weights"][3].__setitem__(0, "1.0"), "weights holds something that is not"),
        (lambda c: c["weights"][3].__setitem__(0, 10**400), "weights: .*too large"),
        (lambda c: c.update(weights=[1.0] * 12), r"weights have shape \(12,\)"),
        (lambda c: c["fit"]["singular_values"].pop(), r"singular_values have shape \(11,\)"),
        (lambda c: c["fit"].update(rank=13), "rank = 13: expected 0 to 12"),
        (lambda c: c["fit"].update(rank=True), "rank is of type bool"),
        (lambda c: c["fit"].update(training_error=-1.0), "training_error = -1.0"),
        (lambda c: c["fit"].update(single_output=True), "single_output is true.*2 outputs"),
        (lambda c: c["settings"].update(bias=True), r"weights have shape \(12, 2\).*\(13,"),
        (lambda c: c["settings"].update(method="lasso"), "method = 'lasso'"),
        (lambda c: c["settings"].update(depth=3), "settings holds.*'depth'"),
        (lambda c: c["settings"].pop("ridge"), "settings holds"),
        (lambda c: c["body"].pop("arm_density"), r"body lacks \['arm_density'\]"),
        (lambda c: c["body"].update(colour="red"), "body: unknown parameters.*colour"),
        (lambda c: c["body"].update(arm_density=-1.0), "body: arm_density"),
        (lambda c: c["body"].update(compartments="3"), "body: "),
        (lambda c: c["body"].update(compartments=4), r"\(12, 2\), expected \(16, outputs\)"),
    ],
)
def test_what_is_wrong_is_named(path, edit, message):
    change(path, edit)
    with pytest.raises(ValueError, match=message) as caught:
        load_readout(path)
    assert str(path) in str(caught.value)


def test_a_number_beyond_the_range_of_floats_is_refused(path):
    text = path.read_text(encoding="utf-8")
    first = repr(json.loads(text)["weights"][0][0])
    path.write_text(text.replace(first, "1e999"), encoding="utf-8")
    with pytest.raises(ValueError, match="weights holds numbers that are not finite"):
        load_readout(path)


def test_a_list_is_no_readout(path):
    path.write_text("[]", encoding="utf-8")
    with pytest.raises(ValueError, match="not a readout file"):
        load_readout(path)


def test_a_file_that_is_not_there_is_an_os_error(tmp_path):
    with pytest.raises(FileNotFoundError, match="none"):
        load_readout(tmp_path / "none.json")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"readout": Readout()}, "not fitted"),
        ({"parameters": BODY.replace(compartments=4)}, "12 lengths, the body has 16 springs"),
        ({"protocol": {"R": float("nan")}}, "protocol cannot be written"),
        ({"protocol": {"R": np.ones(2)}}, "protocol cannot be written"),
        ({"seed": 1.5}, "seed = 1.5"),
    ],
)
def test_what_cannot_be_saved_leaves_the_old_file(path, changes, message):
    before = path.read_bytes()
    arguments = {"readout": fitted()[0], "parameters": BODY, "protocol": PROTOCOL} | changes
    with pytest.raises(ValueError, match=message):
        save_readout(path, **arguments)
    assert path.read_bytes() == before
    assert list(path.parent.iterdir()) == [path]


def test_a_generator_cannot_be_saved(path):
    readout, _ = fitted(
        method="noise", noise=1e-5, sampled=True, random_state=np.random.default_rng(0)
    )
    with pytest.raises(ValueError, match="settings cannot be written.*Generator"):
        save_readout(path, readout, parameters=BODY, protocol=PROTOCOL)
