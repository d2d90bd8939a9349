"""The code of documents, as printed there."""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent


def read_page(path: str) -> str:
    return (ROOT / path).read_text(encoding="utf-8")


def code_blocks(path: str, language: str) -> list[str]:
    """All blocks of a language on a page, in their order."""
    return re.findall(rf"```{language}\n(.*?)```", read_page(path), re.S)


def run_python(code: str, folder: Path) -> str:
    """What a block prints when it runs in `folder`, warnings being errors."""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def check_links(path: str) -> None:
    """Files that a page shows or links to exist."""
    folder = (ROOT / path).parent
    for link in re.findall(r"\]\((?!https?:)([^)#]+)", read_page(path)):
        assert (folder / link).is_file(), link
