"""How far long work is: a bar on a terminal, now and then a line in a log."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TextIO

if TYPE_CHECKING:
    from tqdm import tqdm


_INTERVAL = 30.0
"""Between two lines of a log [s]; what takes less time writes none."""

_LINE = "{desc}: {percentage:.0f} % in {elapsed}{postfix}"

_SHARE = "{desc}: {percentage:3.0f}%|{bar}| {elapsed}"


@contextmanager
def progress_bar(
    total: float | None,
    description: str,
    *,
    unit: str = "",
    initial: float = 0,
    shown: bool | None = None,
    **options: Any,
) -> Iterator[tqdm[Any]]:
    """Show on standard error how far long work is, for as long as the ``with`` block.

    On a terminal a bar, which goes when the work has ended. Elsewhere, in a log say, a line every
    half minute, whether or not anything has been finished since.

    Args:
        total: of what is to be done; None: not known yet, it is set later.
        description: what that is.
        unit: of `total`, shown in the bar.
        initial: what has been done already.
        shown: None: as said above; False: nothing; True: a bar, whatever standard error is.
        **options: further ones of `tqdm.tqdm`.

    Yields:
        The bar: `update` it with what has been done since the last time.
    """
    from tqdm import tqdm

    stream = sys.stderr
    options |= {"total": total, "desc": description, "unit": unit, "initial": initial}
    nothing = shown is False or stream is None
    if nothing or shown or stream.isatty():
        with tqdm(**options, file=stream, leave=False, disable=nothing) as bar:
            yield bar
    else:
        # The bar counts; what it would draw goes nowhere.
        with (
            open(os.devnull, "w", encoding="utf-8") as nowhere,
            tqdm(**options | {"file": nowhere, "bar_format": _LINE}) as bar,
            _lines(bar, stream),
        ):
            yield bar


@contextmanager
def stage_bar(description: str, total: float = 1.0) -> Iterator[Callable[[str, float], None]]:
    """As `progress_bar`, for work in stages.

    Args:
        description: of the first stage.
        total: of what is to be done in all.

    Yields:
        To be called with the name of the stage and what has just been done.
    """
    with progress_bar(total, description, bar_format=_SHARE) as bar:

        def advance(stage: str, done: float) -> None:
            bar.set_description_str(stage, refresh=False)
            bar.update(done)

        yield advance


@contextmanager
def _lines(bar: tqdm[Any], stream: TextIO) -> Iterator[None]:
    """Write what a bar would show as a line, every now and then, until the block has ended."""
    ended = threading.Event()

    def write() -> None:
        while not ended.wait(_INTERVAL):
            print(bar, file=stream, flush=True)

    writer = threading.Thread(target=write, name="progress", daemon=True)
    writer.start()
    try:
        yield
    finally:
        ended.set()
        writer.join()
