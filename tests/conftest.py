"""What tests of several folders share."""

import pytest


class Clock:
    """Stands in for the module `time`: only sleep moves it on."""

    def __init__(self) -> None:
        self.now = 0.0

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """The clock that windows go by, however busy the machine is."""
    window = pytest.importorskip("octoarm_env.rendering.window")
    found = Clock()
    monkeypatch.setattr(window, "time", found)
    return found
