"""Measures the page that is committed: python3 rust/web/page/measure.py [PICTURE.png].

It wants Chromium and node on the path, and the packages of `./agents[test]`. What is printed is
what docs/web.md tells; the picture is the one that it shows.
"""

from __future__ import annotations

import gzip
import shutil
import statistics
import subprocess
import sys
import threading
import time

import numpy as np
from octoarm_agents.web.serving import PAGE, PageServer
from playwright.sync_api import Browser, Page, sync_playwright

from octoarm_env import Arm

# WebGL without a graphics card: the frames are drawn by the processor.
OPTIONS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
STEPS, ROUNDS = 4_000, 9
BROTLI = """
const chunks = [];
process.stdin.on("data", (chunk) => chunks.push(chunk)).on("end", () => {
  console.log(require("node:zlib").brotliCompressSync(Buffer.concat(chunks)).length);
});
"""


def swing(steps: int) -> np.ndarray:
    """Give base angles (steps, 2) [degrees] of a brisk movement."""
    seconds = np.arange(1, steps + 1) * 1e-3
    return 60.0 * np.stack((np.sin(7.0 * seconds), np.sin(11.0 * seconds)), axis=1)


def open_page(browser: Browser, url: str, kind: str) -> Page:
    """Open the page with one of its two modules."""
    page = browser.new_page(viewport={"width": 1280, "height": 800})
    page.goto(f"{url}?wasm={kind}")
    page.wait_for_function("window.octoarm?.frames.drawn > 0")
    return page


def microseconds(page: Page) -> float:
    """Time of a physics step in the page [µs]."""
    taken: float = page.evaluate(
        """([angles, steps]) => {
            const numbers = new Float64Array(angles);
            const begin = performance.now();
            octoarm.physics.run("{}", numbers);
            return 1000 * (performance.now() - begin) / steps;
        }""",
        [swing(STEPS).ravel().tolist(), STEPS],
    )
    return taken


def native() -> float:
    """Time of a physics step here [µs]."""
    arm, angles = Arm(), swing(STEPS)
    begin = time.perf_counter()
    arm.run(angles)
    return 1e6 * (time.perf_counter() - begin) / STEPS


def brotli_size(content: bytes) -> int:
    """Give the size of a file by Brotli [bytes]."""
    command = ["node", "-e", BROTLI]
    return int(subprocess.run(command, input=content, stdout=subprocess.PIPE, check=True).stdout)


def sizes() -> None:
    """Print what a visitor loads, compressed."""
    (page,) = PAGE.glob("*.html")
    modules = sorted((PAGE / "assets").glob("*.wasm"))
    glue = sorted((PAGE / "assets").glob("octoarm_web-*.js"))
    first = [page, *(PAGE / "assets").glob("index-*"), modules[-1], glue[-1]]
    for name, files in (("page", first), ("a network", [PAGE / "agents" / "quadratic.bin"])):
        contents = [file.read_bytes() for file in files]
        packed = sum(len(gzip.compress(content, 9)) for content in contents)
        brotli = sum(map(brotli_size, contents))
        print(f"{name}: {packed / 1000:.0f} kB by gzip, {brotli / 1000:.0f} kB by Brotli")


def main() -> None:
    """Measure and print."""
    sizes()
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))))
    with PageServer() as server, sync_playwright() as playwright:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        browser = playwright.chromium.launch(executable_path=chromium, args=OPTIONS)
        pages = {kind: open_page(browser, server.url, kind) for kind in ("simd", "plain")}
        for page in pages.values():
            page.click("#pause")
        taken: dict[str, list[float]] = {"native": [], "simd": [], "plain": []}
        for _ in range(ROUNDS):  # in turns: what else the machine does falls on all
            taken["native"].append(native())
            for kind, page in pages.items():
                taken[kind].append(microseconds(page))
        for kind, each in taken.items():
            least, middle = min(each), statistics.median(each)
            print(f"{kind}: {least:.1f} µs a step, {1e6 / least:,.0f} steps/s; median {middle:.1f}")
        for page in pages.values():
            page.close()
        first = []
        for _ in range(ROUNDS):
            page = open_page(browser, server.url, "simd")
            mark = "performance.getEntriesByName('octoarm-first-frame')[0].startTime"
            first.append(page.evaluate(mark))
            page.close()
        print(f"first frame after {min(first):.0f} ms; median {statistics.median(first):.0f}")
        page = open_page(browser, server.url, "simd")
        state = "({drawn: octoarm.frames.drawn, at: performance.now(), time: octoarm.arm.time})"
        begin = page.evaluate(state)
        page.wait_for_timeout(5_000)
        end = page.evaluate(state)
        drawn, time_passed = end["drawn"] - begin["drawn"], end["time"] - begin["time"]
        seconds = (end["at"] - begin["at"]) / 1000
        print(f"{drawn / seconds:.1f} frames/s, {time_passed / seconds:.2f} of real time")
        cost = min(page.evaluate("octoarm.cost()") for _ in range(ROUNDS))
        print(f"a frame costs {cost:.2f} ms beside its drawing: 17 steps, skin and plots")
        if len(sys.argv) > 1:
            page.click("#tab-teach")
            page.click("#teach-fast")
            page.wait_for_function("octoarm.arm.lesson_steps >= 16000", timeout=120_000)
            page.click("#fit")
            page.click("#let-go")
            page.wait_for_timeout(4_000)
            page.screenshot(path=sys.argv[1])
        browser.close()
        server.shutdown()


if __name__ == "__main__":
    main()
