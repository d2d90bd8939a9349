/** The page: what its buttons do, and a frame after the other. */

import "./style.css";
import { drawStrain, drawThumbnail, drawWeights, Portrait } from "./plots";
import { type Driver, loadPhysics, type Octoarm, type Physics, view } from "./physics";
import { ArmScene } from "./scene";

/** How each cycle is taught: amplitude [degrees], steps, and the noise that the fit allows for [m]. */
const CYCLES = {
  quadratic: { amplitude: 90, steps: 20_000, noise: 1e-6 },
  van_der_pol: { amplitude: 130, steps: 20_000, noise: 1e-9 },
  lissajous: { amplitude: 10, steps: 70_000, noise: 1e-9 },
} as const;
type Target = keyof typeof CYCLES;

/** First steps of a lesson that are not used, as in rust/web/src/simulation.rs. */
const WASHOUT = 4_000;
/** Steps that the teacher swings the arm before a network takes it. */
const FORCED = 5_000;
/** Longest time that a frame makes up for [s], and that it may compute when time runs quickly [ms]. */
const LONGEST = 0.15;
const QUICK = 11;
/** Steps between two points of the base's way. */
const POINT = 8;
/** Degrees that an arrow key turns the base. */
const KEY_TURN = 4;

const DRIVERS: Record<Driver, string> = {
  hand: "you",
  teacher: "the teacher",
  readout: "its own springs",
  network: "the network",
};
const BODIES = {
  nakajima2013: "The paper's model: the turning base turns gravity, and arm and water move in its frame.",
  inertial: "The base carries the arm along, with all its inertia. It is harder to swing, and a push may tear it.",
};

function find<E extends HTMLElement = HTMLElement>(id: string): E {
  const found = document.getElementById(id);
  if (!found) throw new Error(`the page has no ${id}`);
  return found as E;
}
const button = (id: string): HTMLButtonElement => find<HTMLButtonElement>(id);
const input = (id: string): HTMLInputElement => find<HTMLInputElement>(id);
const canvas = (id: string): HTMLCanvasElement => find<HTMLCanvasElement>(id);

class Page {
  readonly arm: Octoarm;
  readonly scene: ArmScene;
  /** Frames that were drawn, and since when: for those who measure. */
  readonly frames = { drawn: 0, since: performance.now() };
  private readonly portrait = new Portrait(canvas("portrait"));
  private readonly still = matchMedia("(prefers-reduced-motion: reduce)").matches;
  private target: Target = "quadratic";
  private paused = false;
  /** The steps that a lesson shall have before time runs as usual again; 0: it does. */
  private quick = 0;
  private taught = false;
  private network: { target: Target; file: Uint8Array } | null = null;
  private networkWaits = false;
  /** Who gets the base back when a hand lets go of it. */
  private resume: Driver | null = null;
  private touched = false;
  private before = performance.now();
  private owed = 0;
  private lastDriver: Driver | null = null;
  private loopBegan = 0;

  constructor(readonly physics: Physics) {
    this.arm = new physics.Octoarm(this.body());
    const hand = {
      drag: (theta: number, phi: number) => this.take(theta, phi),
      release: () => this.giveBack(),
    };
    this.scene = new ArmScene(canvas("scene"), hand, this.still);
    this.listen();
    this.setTarget("quadratic");
    find("build").textContent = physics.kind === "simd" ? "with 128-bit vectors" : "without vectors";
    find("loading").hidden = true;
    this.showDriver();
    this.drawThumbnails();
    requestAnimationFrame((now) => this.frame(now));
  }

  /** So many steps of 1 ms at once; what fails is shown. Gives the number that was made. */
  advance(steps: number): number {
    let made = 0;
    try {
      while (made < steps) {
        const wanted = Math.min(POINT, steps - made);
        const now = this.arm.advance(wanted);
        made += now;
        this.portrait.add(this.arm.time, this.arm.theta, this.arm.phi);
        if (now < wanted) break;
      }
    } catch (error) {
      this.refuse(error);
    }
    return made;
  }

  /** Time of a frame without what the graphics do [ms]: for those who measure. */
  cost(): number {
    const begin = performance.now();
    for (let k = 0; k < 50; k++) {
      this.advance(17);
      this.update();
    }
    return (performance.now() - begin) / 50;
  }

  get driver(): Driver {
    return this.arm.driver as Driver;
  }

  private frame(now: number): void {
    requestAnimationFrame((next) => this.frame(next));
    const passed = Math.min((now - this.before) / 1000, LONGEST);
    this.before = now;
    if (!this.paused) {
      if (this.quick > 0) this.hurry(passed);
      else {
        this.idle(now);
        this.owed += 1000 * passed;
        const steps = Math.floor(this.owed);
        this.owed -= steps;
        this.advance(steps);
      }
    }
    this.afterSteps();
    this.update();
    this.scene.draw(now / 1000);
    if (this.frames.drawn++ === 0) performance.mark("octoarm-first-frame");
  }

  /** An arm that nobody has touched yet sways a little. */
  private idle(now: number): void {
    if (this.touched || this.still) return;
    const time = now / 1000;
    this.arm.drag(22 * Math.sin(1.7 * time), 16 * Math.sin(2.6 * time));
  }

  /** As many steps as a frame has time for: half of the time where frames are slow to draw. */
  private hurry(passed: number): void {
    const end = performance.now() + Math.max(QUICK, 500 * passed);
    while (performance.now() < end && this.quick > 0) {
      const left = this.quick - this.forced();
      if (left <= 0 || this.driver !== "teacher") this.quick = 0;
      else this.advance(Math.min(left, 50));
    }
    this.owed = 0;
  }

  private forced(): number {
    return Math.round(1000 * this.arm.time);
  }

  /** What follows from where the arm is now. */
  private afterSteps(): void {
    const cycle = CYCLES[this.target];
    if (this.driver === "teacher") {
      const share = Math.min(this.forced() / cycle.steps, 1);
      if (this.networkWaits) {
        if (this.forced() >= FORCED) this.networkTakes();
      } else {
        input("lesson").value = String(share);
        (find("lesson") as unknown as HTMLProgressElement).value = share;
        const rows = this.arm.lesson_steps;
        find("lesson-text").textContent =
          rows === 0
            ? `The arm comes from rest: the first ${WASHOUT / 1000} s do not count.`
            : `${(rows / 1000).toFixed(1)} s written down: ${rows.toLocaleString("en")} rows of 80 lengths.` +
              (share < 1 ? "" : " That is enough.");
        button("fit").disabled = rows < 1000;
        if (share === 1 && !this.taught) {
          this.taught = true;
          this.say("The lesson is long enough. Press fit.");
          find("step-fit").classList.add("now");
        }
      }
    }
    if (this.driver !== this.lastDriver) this.showDriver();
    if (this.driver === "readout" || this.driver === "network") {
      const seconds = this.arm.time - this.loopBegan;
      find("go-text").textContent = `Alone for ${seconds.toFixed(1)} s: ${(seconds / this.arm.turn).toFixed(1)} turns.`;
    }
  }

  /** Shows where the arm is now. */
  private update(): void {
    const { arm, physics } = this;
    const planes = arm.compartments + 1;
    const joints = view(physics, arm.joints(), 12 * planes);
    const lengths = view(physics, arm.lengths(), 4 * arm.compartments);
    const [theta, phi, time] = [arm.theta, arm.phi, arm.time];
    this.scene.setPose(joints, lengths, arm.rest_length, theta, phi);
    this.scene.setTrail(this.portrait.past);
    this.portrait.draw();
    drawStrain(canvas("strain"), lengths, arm.rest_length);
    find("clock").textContent = time.toFixed(1);
    find("theta").textContent = `${theta.toFixed(0)}°`;
    find("phi").textContent = `${phi.toFixed(0)}°`;
    const alone = this.driver === "readout" || this.driver === "network";
    find("distance").hidden = !alone;
    if (alone) {
      const share = 100 * arm.distance;
      find("distance").textContent = `${share < 0.1 ? "under 0.1" : share.toFixed(1)} % of the amplitude off the target`;
    }
    find("hint").hidden = this.touched;
  }

  // Who commands the base.

  private take(theta: number, phi: number): void {
    this.touched = true;
    if (this.driver !== "hand") {
      if (this.driver === "readout" || this.driver === "network") this.resume = this.driver;
      this.quick = 0;
      this.networkWaits = false;
    }
    this.attempt(() => this.arm.drag(theta, phi));
  }

  private giveBack(): void {
    const to = this.resume;
    this.resume = null;
    if (to === "readout") this.letGo();
    else if (to === "network") this.networkTakes();
  }

  private turn(theta: number, phi: number): void {
    const clamp = (angle: number): number => Math.max(-100, Math.min(100, angle));
    const [t, p] = this.driver === "hand" && this.touched ? this.goal : [this.arm.theta, this.arm.phi];
    this.goal = [clamp(t + theta), clamp(p + phi)];
    this.take(...this.goal);
    this.resume = null;
    this.say(`Base at theta ${this.goal[0].toFixed(0)}, phi ${this.goal[1].toFixed(0)} degrees.`);
  }
  private goal: [number, number] = [0, 0];

  private teach(quickly: boolean): void {
    this.touched = true;
    const { amplitude, steps } = CYCLES[this.target];
    this.attempt(() => {
      if (this.driver !== "teacher" || this.networkWaits || this.forced() >= steps) {
        this.arm.begin_lesson(this.target, amplitude);
        this.taught = false;
        this.clear();
      }
      this.networkWaits = false;
      this.quick = quickly ? steps : 0;
      this.mark("step-teach");
    });
  }

  private fit(): void {
    this.attempt(() => {
      const error = this.arm.fit(CYCLES[this.target].noise);
      find("fit-text").textContent = `Off by ${error < 0.1 ? error.toFixed(3) : error.toFixed(1)}° on average. Each bar is the weight of a spring:`;
      this.showWeights();
      button("let-go").disabled = button("readout-again").disabled = false;
      this.mark("step-go");
      this.say(`Fitted, with an error of ${error.toFixed(3)} degrees. Now let go.`);
    });
  }

  private showWeights(): void {
    const pointer = this.arm.weights();
    const drawing = canvas("weights");
    drawing.hidden = pointer === 0;
    if (pointer !== 0) drawWeights(drawing, view(this.physics, pointer, 8 * this.arm.compartments));
  }

  private letGo(): void {
    this.touched = true;
    this.attempt(() => {
      if (this.driver === "network") this.networkWaits = false;
      this.quick = 0;
      this.arm.let_go();
      this.loopBegan = this.arm.time;
      this.say("The arm swings by itself.");
    });
  }

  private async letNetwork(): Promise<void> {
    this.touched = true;
    const { target } = this;
    try {
      if (this.network?.target !== target) {
        const answer = await fetch(`agents/${target}.bin`);
        if (!answer.ok) throw new Error(`agents/${target}.bin: ${answer.status} ${answer.statusText}`);
        this.network = { target, file: new Uint8Array(await answer.arrayBuffer()) };
      }
    } catch (error) {
      this.refuse(error);
      return;
    }
    if (this.driver === "readout") return this.networkTakes();
    // It was trained on arms that swing already: the teacher begins.
    this.attempt(() => {
      if (this.driver !== "teacher" || this.forced() < WASHOUT) {
        this.arm.begin_lesson(target, CYCLES[target].amplitude);
        this.clear();
      }
      this.networkWaits = true;
      this.quick = Math.max(FORCED, this.forced());
    });
  }

  private networkTakes(): void {
    this.networkWaits = false;
    this.quick = 0;
    const { network } = this;
    if (!network) return;
    this.attempt(() => {
      this.arm.let_network(network.file);
      this.loopBegan = this.arm.time;
      this.say("The network swings the arm.");
    });
  }

  private push(): void {
    this.touched = true;
    const size = Number(input("push-size").value);
    const angle = 2 * Math.PI * Math.random();
    this.attempt(() => {
      this.arm.push(size * Math.cos(angle), size * Math.sin(angle));
      this.say(`Pushed by ${size} degrees.`);
    });
  }

  private rest(): void {
    this.touched = true;
    this.quick = 0;
    this.networkWaits = false;
    this.resume = null;
    this.goal = [0, 0];
    this.attempt(() => {
      this.arm.reset();
      this.clear();
      this.say("The arm is at rest.");
    });
  }

  // Settings.

  private setTarget(target: Target): void {
    this.target = target;
    this.quick = 0;
    this.networkWaits = false;
    this.attempt(() => {
      if (this.driver !== "hand") this.arm.reset();
      this.arm.set_target(target, CYCLES[target].amplitude);
      this.clear();
      button("fit").disabled = button("let-go").disabled = button("readout-again").disabled = true;
      this.taught = false;
      (find("lesson") as unknown as HTMLProgressElement).value = 0;
      find("lesson-text").textContent = `This cycle takes ${CYCLES[target].steps / 1000} s to learn.`;
      find("fit-text").textContent = find("go-text").textContent = "";
      canvas("weights").hidden = true;
      this.mark("step-teach");
    });
    const orbit = this.orbit();
    this.portrait.setOrbit(orbit);
    this.scene.setOrbit(orbit);
  }

  private orbit(): Float64Array {
    return view(this.physics, this.arm.orbit(), 2 * this.arm.orbit_points).slice();
  }

  private body(): string {
    const preset = document.querySelector<HTMLInputElement>("input[name=preset]:checked")?.value ?? "nakajima2013";
    const body = JSON.parse(this.physics.preset(preset)) as Record<string, number>;
    const part = (id: string): number => Number(input(id).value) / 100;
    body.longitudinal_stiffness! *= part("stiffness");
    body.longitudinal_damping! *= part("damping");
    body.area_scale! *= part("area");
    body.arm_density = Number(input("density").value);
    return JSON.stringify(body);
  }

  private setBody(): void {
    this.attempt(() => {
      this.arm.set_body(this.body());
      this.quick = 0;
      button("fit").disabled = true;
      this.taught = false;
      find("lesson-text").textContent = "Another body: the lesson begins anew.";
      (find("lesson") as unknown as HTMLProgressElement).value = 0;
    });
  }

  private bodyBack(preset?: string): void {
    input("stiffness").value = input("damping").value = input("area").value = "100";
    const chosen = preset ?? "nakajima2013";
    for (const each of document.querySelectorAll<HTMLInputElement>("input[name=preset]")) each.checked = each.value === chosen;
    input("density").value = String((JSON.parse(this.physics.preset(chosen)) as { arm_density: number }).arm_density);
    this.showSliders();
    this.setBody();
  }

  private setNoise(): void {
    this.attempt(() => this.arm.set_noise(Number(input("command-noise").value), 1e-6 * Number(input("length-noise").value)));
  }

  // What is shown.

  private clear(): void {
    this.portrait.clear();
    find("alert").hidden = true;
  }

  private mark(step: string): void {
    for (const each of document.querySelectorAll(".steps li")) each.classList.toggle("now", each.id === step);
  }

  private showDriver(): void {
    this.lastDriver = this.driver;
    find("driver").textContent = DRIVERS[this.driver];
    document.body.dataset.driver = this.driver;
    this.showTargets();
    this.showSliders();
  }

  private showTargets(): void {
    const shown = this.driver !== "hand" || find("tab-drag").ariaSelected !== "true";
    this.scene.showTarget(shown);
  }

  private showSliders(): void {
    const text: Record<string, (value: number) => string> = {
      "push-size": (value) => `${value}°`,
      "command-noise": (value) => `±${value}°`,
      "length-noise": (value) => `±${value} µm`,
      stiffness: (value) => `${value} %`,
      damping: (value) => `${value} %`,
      area: (value) => `${value} %`,
      density: (value) => `${value} kg/m³`,
    };
    for (const [id, words] of Object.entries(text)) {
      const said = words(Number(input(id).value));
      find(`${id}-out`).textContent = said;
      input(id).ariaValueText = said;
    }
    const preset = document.querySelector<HTMLInputElement>("input[name=preset]:checked")?.value as keyof typeof BODIES;
    find("preset-text").textContent = BODIES[preset];
    const alone = this.driver === "readout" || this.driver === "network";
    find("disturb-text").textContent = alone
      ? `${DRIVERS[this.driver][0]!.toUpperCase()}${DRIVERS[this.driver].slice(1)} swing${this.driver === "network" ? "s" : ""} the arm.`
      : "Nothing swings the arm by itself yet: teach it first, or let the network do it.";
  }

  private drawThumbnails(): void {
    for (const drawing of document.querySelectorAll<HTMLCanvasElement>("canvas.orbit")) {
      const target = drawing.dataset.target as Target;
      const other = new this.physics.Octoarm("{}");
      other.set_target(target, CYCLES[target].amplitude);
      drawThumbnail(drawing, view(this.physics, other.orbit(), 2 * other.orbit_points).slice());
      other.free();
    }
  }

  private say(words: string): void {
    find("status").textContent = words;
  }

  private attempt(work: () => void): void {
    try {
      work();
      find("alert").hidden = true;
    } catch (error) {
      this.refuse(error);
    }
  }

  private refuse(error: unknown): void {
    const words = error instanceof Error ? error.message : String(error);
    find("alert").textContent = `${words[0]?.toUpperCase() ?? ""}${words.slice(1)}.`;
    find("alert").hidden = false;
    this.quick = 0;
    this.resume = null;
  }

  private show(tab: string): void {
    for (const each of document.querySelectorAll<HTMLButtonElement>("[role=tab]")) {
      const chosen = each.id === `tab-${tab}`;
      each.ariaSelected = String(chosen);
      each.tabIndex = chosen ? 0 : -1;
      find(each.getAttribute("aria-controls")!).hidden = !chosen;
    }
    document.querySelector("aside")!.scrollTop = 0;
    this.showTargets();
    if (tab === "teach") {
      this.drawThumbnails();
      this.showWeights();
    }
  }

  private listen(): void {
    const tabs = [...document.querySelectorAll<HTMLButtonElement>("[role=tab]")];
    for (const [index, tab] of tabs.entries()) {
      tab.addEventListener("click", () => this.show(tab.id.slice(4)));
      tab.addEventListener("keydown", (event) => {
        const step = event.key === "ArrowRight" ? 1 : event.key === "ArrowLeft" ? -1 : 0;
        if (step === 0) return;
        const next = tabs[(index + step + tabs.length) % tabs.length]!;
        next.focus();
        this.show(next.id.slice(4));
      });
    }
    for (const each of document.querySelectorAll<HTMLButtonElement>(".next"))
      each.addEventListener("click", () => {
        this.show(each.dataset.tab!);
        find(`tab-${each.dataset.tab}`).focus();
      });
    const clicks: Record<string, () => void> = {
      teach: () => this.teach(false),
      "teach-fast": () => this.teach(true),
      fit: () => this.fit(),
      "let-go": () => this.letGo(),
      network: () => void this.letNetwork(),
      "readout-again": () => this.letGo(),
      "network-again": () => void this.letNetwork(),
      push: () => this.push(),
      "push-now": () => this.push(),
      rest: () => this.rest(),
      pause: () => this.pause(),
      "body-back": () => this.bodyBack(),
    };
    for (const [id, work] of Object.entries(clicks)) button(id).addEventListener("click", work);
    for (const each of document.querySelectorAll<HTMLInputElement>("input[name=target]"))
      each.addEventListener("change", () => this.setTarget(each.value as Target));
    for (const each of document.querySelectorAll<HTMLInputElement>("input[name=preset]"))
      each.addEventListener("change", () => this.bodyBack(each.value));
    for (const each of document.querySelectorAll<HTMLInputElement>("input[type=range]"))
      each.addEventListener("input", () => this.showSliders());
    for (const id of ["command-noise", "length-noise"]) input(id).addEventListener("input", () => this.setNoise());
    for (const id of ["stiffness", "damping", "area", "density"]) input(id).addEventListener("input", () => this.setBody());
    const keys: Record<string, () => void> = {
      ArrowLeft: () => this.turn(0, -KEY_TURN),
      ArrowRight: () => this.turn(0, KEY_TURN),
      ArrowUp: () => this.turn(-KEY_TURN, 0),
      ArrowDown: () => this.turn(KEY_TURN, 0),
      " ": () => this.pause(),
      p: () => this.push(),
      r: () => this.rest(),
    };
    canvas("scene").addEventListener("keydown", (event) => {
      const work = keys[event.key];
      if (!work || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      work();
    });
    const scheme = matchMedia("(prefers-color-scheme: dark)");
    scheme.addEventListener("change", () => this.drawThumbnails());
    new ResizeObserver(() => this.showWeights()).observe(canvas("weights"));
  }

  private pause(): void {
    this.paused = !this.paused;
    this.owed = 0;
    button("pause").ariaPressed = String(this.paused);
    button("pause").textContent = this.paused ? "Go on" : "Pause";
    this.say(this.paused ? "Paused." : "Going on.");
  }
}

/** Links to the documentation, where the page stands within it: `?docs=../` says where it begins. */
function link(docs: string | null): void {
  if (!docs || !/^[./]+$/.test(docs)) return;
  for (const each of document.querySelectorAll<HTMLAnchorElement>("a[data-page]")) {
    each.href = docs + each.dataset.page!;
    each.target = "_top";
  }
  find("links").hidden = false;
}

declare global {
  interface Window {
    /** For the console, and for who tests or measures the page. */
    octoarm?: Page;
  }
}

const asked = new URLSearchParams(location.search);
link(asked.get("docs"));
try {
  window.octoarm = new Page(await loadPhysics(asked.get("wasm")));
  performance.mark("octoarm-ready");
} catch (error) {
  find("loading").textContent = `The arm cannot be shown here: ${error instanceof Error ? error.message : String(error)}.`;
  throw error;
}
