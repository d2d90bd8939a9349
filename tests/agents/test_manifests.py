"""The files that start a cluster: what can be told of them without one."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "docs/cluster"


def load(name: str) -> Any:
    yaml = pytest.importorskip("yaml")
    return yaml.safe_load((FOLDER / name).read_text(encoding="utf-8"))


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
def test_the_script_for_slurm_can_be_read() -> None:
    script = FOLDER / "octoarm.sbatch"
    assert "octoarm compare --cluster auto" in script.read_text(encoding="utf-8")
    subprocess.run(["bash", "-n", script], check=True)


def test_ray_takes_the_file_of_ray_up() -> None:
    util = pytest.importorskip("ray.autoscaler._private.util")
    util.validate_config(util.prepare_config(load("ray-up.yaml")))
    with pytest.raises(Exception, match="Additional properties are not allowed"):
        util.validate_config(util.prepare_config(load("ray-up.yaml") | {"image": "octoarm"}))


def test_kubernetes_takes_the_pods_of_kuberay() -> None:
    checker = pytest.importorskip("kubernetes_validate")
    spec = load("kuberay.yaml")["spec"]
    groups = [spec["headGroupSpec"], *spec["workerGroupSpecs"]]
    for group in groups:
        pod = {
            "apiVersion": "v1",
            "kind": "Pod",
            "metadata": {"name": "octoarm"},
            **group["template"],
        }
        checker.validate(pod, checker.latest_version(), strict=True)
    pod["spec"]["containers"][0]["image"] = 1
    with pytest.raises(checker.ValidationError):
        checker.validate(pod, checker.latest_version(), strict=True)


def test_every_node_has_the_ray_that_is_tested_here() -> None:
    constraints = (ROOT / "constraints.txt").read_text(encoding="utf-8")
    (version,) = re.findall(r"^ray==(.*)$", constraints, re.MULTILINE)
    assert load("kuberay.yaml")["spec"]["rayVersion"] == version
    assert f"rayproject/ray:{version}-py311" in (FOLDER / "Dockerfile").read_text(encoding="utf-8")
