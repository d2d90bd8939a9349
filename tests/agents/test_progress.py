"""What long work shows of itself: a bar on a terminal, lines in a log."""

from __future__ import annotations

import io
import re
import sys
import threading
from pathlib import Path
from typing import Any

import octoarm_agents
import pytest
from octoarm_agents.common import progress
from octoarm_agents.common.progress import progress_bar, stage_bar


class Log(io.StringIO):
    """Standard error in a file; knows when a text has been written."""

    def __init__(self, wanted: str = "") -> None:
        super().__init__()
        self.wanted = wanted
        self.written = threading.Event()

    def write(self, text: str) -> int:
        count = super().write(text)
        if self.wanted in self.getvalue():
            self.written.set()
        return count


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_log_gets_lines_even_while_nothing_is_finished(monkeypatch: pytest.MonkeyPatch) -> None:
    log = Log("ppo: 3.0\n")
    monkeypatch.setattr(sys, "stderr", log)
    monkeypatch.setattr(progress, "_INTERVAL", 0.001)
    with progress_bar(4, "trainings", initial=1) as bar:
        bar.set_postfix_str("ppo: 3.0")
        # Nothing is finished, and yet lines come.
        assert log.written.wait(60)
    for line in log.getvalue().splitlines():
        assert re.fullmatch(r"trainings: 25 % in \d\d:\d\d(, ppo: 3\.0)?", line)
    assert "\r" not in log.getvalue()
    length = len(log.getvalue())
    # The writer has ended with the block.
    assert not [each for each in threading.enumerate() if each.name == "progress"]
    assert len(log.getvalue()) == length


def test_stages_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    log = Log("drawing: 50 % in")
    monkeypatch.setattr(sys, "stderr", log)
    monkeypatch.setattr(progress, "_INTERVAL", 0.001)
    with stage_bar("starting", 10) as advance:
        advance("drawing", 5)
        assert log.written.wait(60)


def test_a_total_that_is_not_known_yet(monkeypatch: pytest.MonkeyPatch) -> None:
    log = Log("measuring: 0 % in")
    monkeypatch.setattr(sys, "stderr", log)
    monkeypatch.setattr(progress, "_INTERVAL", 0.001)
    with progress_bar(None, "measuring") as bar:
        assert log.written.wait(60)
        bar.total = 4
        bar.update(4)


def test_short_work_writes_nothing_into_a_log(monkeypatch: pytest.MonkeyPatch) -> None:
    log = Log()
    monkeypatch.setattr(sys, "stderr", log)
    with progress_bar(2, "trials") as bar:
        bar.update(2)
    assert log.getvalue() == ""


def test_work_that_fails_ends_the_lines() -> None:
    with pytest.raises(ValueError, match="broken"), progress_bar(2, "trials"):
        raise ValueError("broken")
    assert not [each for each in threading.enumerate() if each.name == "progress"]


@pytest.mark.parametrize("stream", [Log, Terminal])
def test_nothing_where_nothing_is_wanted(stream: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    found = stream()
    monkeypatch.setattr(sys, "stderr", found)
    monkeypatch.setattr(progress, "_INTERVAL", 0.0)
    with progress_bar(2, "trials", shown=False) as bar:
        bar.update(2)
    assert found.getvalue() == ""


def test_without_standard_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", None)
    with progress_bar(2, "trials") as bar:
        bar.update(2)


def test_a_terminal_gets_a_bar_that_goes(monkeypatch: pytest.MonkeyPatch) -> None:
    found = Terminal()
    monkeypatch.setattr(sys, "stderr", found)
    with progress_bar(2, "trials") as bar:
        bar.update()
    assert "trials:   0%|" in found.getvalue()
    # Written over.
    assert found.getvalue().endswith("\r")


def test_there_is_no_other_bar() -> None:
    package = Path(octoarm_agents.__file__).parent
    others = {
        path.name
        for path in package.rglob("*.py")
        if re.search(r"import tqdm|rich\.progress", path.read_text(encoding="utf-8"))
    }
    assert others == {"progress.py"}
