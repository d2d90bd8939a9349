"""The arm in the browser: the page that is shipped, in headless Chromium, and who serves it."""

from __future__ import annotations

import base64
import http.client
import importlib.util
import os
import re
import shutil
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from octoarm_agents.policies import load_trained
from octoarm_agents.web.serving import PAGE, PageNotFoundError, PageServer

from octoarm_env import Arm, ArmParameters

ROOT = Path(__file__).parents[2]
CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
# WebGL without a graphics card.
OPTIONS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
WAIT = 60_000
"""Longest wait for something that the page does [ms]: only a fault takes so long."""

STEPS = 1_000
FAST = 1e-9
"""What docs/web.md promises for the build with plain multiply-adds: 1e-9 m over 1,000 steps."""


@pytest.fixture(scope="module")
def url() -> Iterator[str]:
    with PageServer() as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield server.url
        server.shutdown()
        thread.join()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    if CHROMIUM is None:
        pytest.skip("no Chromium on the path")
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=OPTIONS)
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def loaded(browser: Any, url: str) -> Iterator[tuple[Any, list[str]]]:
    page = browser.new_page(viewport={"width": 800, "height": 600}, reduced_motion="reduce")
    complaints: list[str] = []
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on(
        "console",
        lambda message: complaints.append(message.text) if message.type == "error" else None,
    )
    page.on("requestfailed", lambda request: complaints.append(request.url))
    page.goto(url)
    page.wait_for_function("window.octoarm !== undefined", timeout=WAIT)
    yield page, complaints
    page.close()


@pytest.fixture
def page(loaded: tuple[Any, list[str]]) -> Iterator[Any]:
    """The page with its arm at rest; whatever a test does, nothing is complained of."""
    page, complaints = loaded
    page.click("#rest")
    page.click("#tab-drag")
    yield page
    assert complaints == []


def arm(page: Any, what: str) -> Any:
    return page.evaluate(f"octoarm.arm.{what}")


def advance(page: Any, steps: int) -> float:
    """Go on by physics steps, and give the largest distance from the orbit on the way [R]."""
    farthest: float = page.evaluate(
        """(steps) => {
            let farthest = 0;
            for (let made = 0; made < steps; made += 10) {
                octoarm.advance(Math.min(10, steps - made));
                farthest = Math.max(farthest, octoarm.arm.distance);
            }
            return farthest;
        }""",
        steps,
    )
    return farthest


def teach(page: Any) -> None:
    page.click("#tab-teach")
    page.click("#teach-fast")
    page.wait_for_function("octoarm.arm.lesson_steps >= 16000", timeout=WAIT)
    page.wait_for_function("!document.getElementById('fit').disabled", timeout=WAIT)
    page.click("#fit")
    page.click("#let-go")


def swing(steps: int) -> np.ndarray:
    """Base angles (steps, 2) [degrees] of a brisk movement."""
    time = np.arange(1, steps + 1) * 1e-3
    return 60.0 * np.stack((np.sin(7.0 * time), np.sin(11.0 * time)), axis=1)


@pytest.mark.parametrize("build", ["simd", "plain"])
def test_lengths_are_those_of_the_native_arm(browser: Any, url: str, build: str) -> None:
    """A page that was built of another arm fails here too."""
    page = browser.new_page(viewport={"width": 64, "height": 64})
    page.goto(f"{url}?wasm={build}")
    page.wait_for_function("window.octoarm !== undefined", timeout=WAIT)
    assert page.evaluate("octoarm.physics.kind") == build
    for preset, share in (("nakajima2013", 1.0), ("inertial", 0.5)):
        body, angles = ArmParameters.preset(preset), share * swing(STEPS)
        encoded = page.evaluate(
            """([body, angles]) => {
                const lengths = octoarm.physics.run(body, new Float64Array(angles));
                let bytes = "";
                for (const byte of new Uint8Array(lengths.buffer))
                    bytes += String.fromCharCode(byte);
                return btoa(bytes);
            }""",
            [body.to_json(), angles.ravel().tolist()],
        )
        lengths = np.frombuffer(base64.b64decode(encoded), dtype="<f8").reshape(STEPS, -1)
        native = Arm(body).run(angles)
        assert np.abs(native - body.rest_length).max() > 1e-4  # they move
        assert np.abs(lengths - native).max() < FAST, (
            "run rust/web/build: the page is of another arm"
        )
    page.close()


def test_the_exact_build_has_the_bits_of_all_machines(tmp_path: Path) -> None:
    target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    module = target / "web" / "exact" / "octoarm_web.js"
    node = shutil.which("node")
    if node is None or not module.is_file():
        pytest.skip(f"needs node, and {module}, which rust/web/build exact makes")
    angles = swing(40)
    script = tmp_path / "run.mjs"
    shutil.copytree(module.parent, tmp_path / "exact")
    (tmp_path / "package.json").write_text('{"type": "module"}', encoding="utf-8")
    script.write_text(
        f"""
        import {{ readFileSync }} from "node:fs";
        import {{ initSync, run }} from "./exact/octoarm_web.js";
        initSync({{ module: readFileSync("exact/octoarm_web_bg.wasm") }});
        const lengths = run("{{}}", new Float64Array({angles.ravel().tolist()}));
        process.stdout.write(Buffer.from(lengths.buffer, lengths.byteOffset, lengths.byteLength));
        """,
        encoding="utf-8",
    )
    ran = subprocess.run([node, script], cwd=tmp_path, capture_output=True, check=True)
    lengths = np.frombuffer(ran.stdout, dtype="<f8").reshape(len(angles), -1)
    same = np.array_equal(lengths, Arm().run(angles))
    assert same, "run rust/web/build exact, if the module is older than the arm"


def test_dragging_moves_the_arm(page: Any) -> None:
    page.click("#pause")  # the test says when time passes
    where = page.evaluate("octoarm.scene.middle()")
    page.mouse.move(where["x"], where["y"])
    page.mouse.down()
    page.mouse.move(where["x"] + 60, where["y"] - 20, steps=4)
    page.evaluate("octoarm.advance(500)")
    turned = arm(page, "phi")
    page.mouse.up()
    page.click("#pause")
    assert turned > 5.0
    assert arm(page, "driver") == "hand"
    page.wait_for_function(f"octoarm.scene.middle().x > {where['x']} + 20", timeout=WAIT)


def test_a_finger_moves_it_too(browser: Any, url: str) -> None:
    context = browser.new_context(has_touch=True, viewport={"width": 390, "height": 844})
    page = context.new_page()
    page.goto(url)
    page.wait_for_function("window.octoarm?.frames.drawn > 0", timeout=WAIT)
    page.click("#pause")
    finger = context.new_cdp_session(page)

    def touch(kind: str, *points: dict[str, float]) -> None:
        finger.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": list(points)})

    where = page.evaluate("octoarm.scene.middle()")
    touch("touchStart", where)
    touch("touchMove", where | {"x": where["x"] - 40.0})
    assert page.evaluate("octoarm.scene.held")
    page.evaluate("octoarm.advance(500)")
    touch("touchEnd")
    assert page.evaluate("octoarm.arm.phi") < -5.0
    assert not page.evaluate("octoarm.scene.held")
    context.close()


def test_the_keys_move_it_too(page: Any) -> None:
    page.focus("#scene")
    for _ in range(5):
        page.keyboard.press("ArrowRight")
    page.evaluate("octoarm.advance(800)")
    assert arm(page, "phi") == pytest.approx(20.0, abs=0.5)
    page.keyboard.press("r")
    assert arm(page, "phi") == 0.0
    page.keyboard.press("ArrowDown")
    page.evaluate("octoarm.advance(800)")
    assert arm(page, "theta") == pytest.approx(4.0, abs=0.1)
    assert "degrees" in page.inner_text("#status")


def test_teach_fit_let_go_holds_the_cycle_for_a_minute(page: Any) -> None:
    teach(page)
    assert arm(page, "driver") == "readout"
    page.wait_for_function("document.getElementById('driver').textContent === 'its own springs'")
    assert re.match(r"Off by 0\.0\d+° on average", page.inner_text("#fit-text"))
    begin = arm(page, "time")
    assert advance(page, 60_000) < 0.05
    assert arm(page, "time") - begin >= 60.0
    assert arm(page, "driver") == "readout"
    # It goes round: the cycle is not held by standing on it.
    angles = page.evaluate(
        "Array.from({length: 60}, () => { octoarm.advance(10); return octoarm.arm.phi; })"
    )
    assert min(angles) < -70.0
    assert max(angles) > 70.0


def test_a_push_is_recovered_from(page: Any) -> None:
    teach(page)
    advance(page, 1_000)
    page.click("#tab-disturb")
    page.evaluate("octoarm.arm.push(-40, 40)")
    assert advance(page, 200) > 0.1
    advance(page, 3_000)
    assert advance(page, 1_000) < 0.02
    # A hand that takes it and lets go is a push too.
    page.evaluate("octoarm.arm.drag(10, 10)")
    advance(page, 300)
    page.click("#readout-again")
    advance(page, 8_000)
    assert advance(page, 1_000) < 0.02


def test_the_network_swings_it(page: Any) -> None:
    page.click("#tab-teach")
    page.click("#network")
    page.wait_for_function("octoarm.arm.driver === 'network'", timeout=WAIT)
    assert advance(page, 3_000) < 0.05


def test_the_network_acts_as_in_python(page: Any) -> None:
    """Its file is that of the policy, and what is computed of it the same to single precision."""
    script = ROOT / "rust" / "web" / "page" / "agents.py"
    spec = importlib.util.spec_from_file_location("page_agents", script)
    assert spec is not None
    assert spec.loader is not None
    agents = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(agents)
    for target in agents.TARGETS:
        assert (PAGE / "agents" / f"{target}.bin").read_bytes() == agents.page_file(target)
    policy = load_trained("ppo", "quadratic")
    observation = Arm().lengths
    action, _ = policy.predict(observation)
    page.click("#pause")
    page.evaluate(
        """async () => {
            const file = await (await fetch("agents/quadratic.bin")).arrayBuffer();
            octoarm.arm.let_network(new Uint8Array(file));
            octoarm.arm.advance(10);
        }"""
    )
    base = np.array([arm(page, "theta"), arm(page, "phi")])
    page.click("#pause")
    assert base == pytest.approx(117.0 * np.asarray(action, dtype=float), abs=1e-4)


def test_refusals_are_those_of_rust(page: Any) -> None:
    def refusal(call: str) -> str:
        words: str = page.evaluate(
            f"""() => {{
                try {{ {call}; return ""; }}
                catch (error) {{
                    return (error instanceof Error ? "" : "no Error: ") + error.message;
                }}
            }}"""
        )
        return words

    begins = {
        "octoarm.arm.drag(200, 0)": "theta = 200 is outside the allowed range [-180, 180] degrees",
        "octoarm.arm.fit(-1)": "noise = -1 is outside the allowed range",
        "octoarm.arm.begin_lesson('circle', 10)": "target: unknown variant `circle`",
        "octoarm.arm.set_body('{\"arm_density\": -1}')": "arm_density = -1 is outside",
        "octoarm.arm.set_body('{\"timestep\": 0.01}')": "timestep = 0.01 is outside",
        "octoarm.arm.let_network(new Uint8Array(3))": "agent: the file is incomplete",
        "octoarm.physics.preset('squid')": 'arm = "squid" is outside the allowed range',
    }
    assert {call: refusal(call)[: len(words)] for call, words in begins.items()} == begins


def test_another_body_is_taken_and_told_of(page: Any) -> None:
    page.click("#tab-body")
    page.check("input[value=inertial]", force=True)
    assert "carries the arm along" in page.inner_text("#preset-text")
    assert page.input_value("#density") == "1303"
    page.evaluate("octoarm.advance(100)")
    page.click("#body-back")
    assert page.is_checked("input[value=nakajima2013]")
    assert page.is_hidden("#alert")


@pytest.mark.parametrize(("width", "height"), [(390, 844), (1280, 800)])
def test_nothing_lies_outside_the_window(page: Any, width: int, height: int) -> None:
    page.set_viewport_size({"width": width, "height": height})
    for tab in ("drag", "teach", "disturb", "body"):
        page.click(f"#tab-{tab}")
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        named = page.evaluate(
            """[...document.querySelectorAll("button, input, [role=img], [role=tab]")]
                .filter((each) => !each.ariaLabel && !each.textContent.trim())
                .filter((each) => !each.labels?.length)
                .map((each) => each.outerHTML)"""
        )
        assert named == []
    page.set_viewport_size({"width": 800, "height": 600})


def ask(url: str, path: str, host: str | None = None) -> http.client.HTTPResponse:
    connection = http.client.HTTPConnection(url.split("/")[2], timeout=10)
    connection.request("GET", path, headers={} if host is None else {"Host": host})
    answer = connection.getresponse()
    answer.read()
    connection.close()
    return answer


def test_files_have_the_types_that_browsers_insist_on(url: str) -> None:
    (module, *_) = (PAGE / "assets").glob("*.wasm")
    (script, *_) = (PAGE / "assets").glob("index-*.js")
    for path, kind in (
        ("/", "text/html; charset=utf-8"),
        (f"/assets/{module.name}", "application/wasm"),
        (f"/assets/{script.name}", "text/javascript"),
    ):
        answer = ask(url, path)
        assert (answer.status, answer.headers["Content-Type"]) == (200, kind)
    assert ask(url, "/../serving.py").status == 404
    assert ask(url, "/", host="elsewhere.example").status == 421


def test_the_page_is_small() -> None:
    """What one visitor loads, compressed: less than a megabyte."""
    import zlib

    files = [path for path in PAGE.rglob("*") if path.is_file() and path.suffix != ".bin"]
    modules = sorted(path for path in files if path.suffix == ".wasm")
    assert len(modules) == 2
    loaded = [path for path in files if path != modules[0]]
    assert sum(len(zlib.compress(path.read_bytes(), 9)) for path in loaded) < 1_000_000


def test_octoarm_web_serves_until_it_is_interrupted() -> None:
    import signal

    command = [sys.executable, "-m", "octoarm_agents.cli", "web", "--port", "0", "--no-open"]
    command[1:3] = ["-c", "from octoarm_agents.cli import main; main()"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, encoding="utf-8") as process:
        assert process.stdout is not None
        line = process.stdout.readline()
        found = re.fullmatch(r"The arm is at (http://127\.0\.0\.1:\d+/) until Ctrl-C\.\n", line)
        assert found is not None, line
        assert ask(found[1], "/").status == 200
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 0


def test_octoarm_web_refuses(octoarm: Any) -> None:
    run = octoarm("web", "--no-open", "--port", "65536")
    assert run.exit_code == 2
    assert "65536 is not between 0 and 65,535" in run.output
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        run = octoarm("web", "--no-open", "--port", port)
    assert run.exit_code == 2
    assert f"127.0.0.1:{port} cannot be had" in " ".join(run.output.replace("│", " ").split())


def test_a_package_without_the_page_says_so(tmp_path: Path) -> None:
    with pytest.raises(PageNotFoundError, match="rust/web/build makes it"):
        PageServer(folder=tmp_path)
