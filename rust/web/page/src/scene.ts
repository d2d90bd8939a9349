/** The arm in water, from all sides, and the hand that takes it. */

import {
  AmbientLight,
  BufferAttribute,
  BufferGeometry,
  CircleGeometry,
  Color,
  CylinderGeometry,
  DirectionalLight,
  DoubleSide,
  Fog,
  Group,
  HemisphereLight,
  Line,
  LineBasicMaterial,
  LineLoop,
  LineSegments,
  Mesh,
  MeshBasicMaterial,
  MeshStandardMaterial,
  PerspectiveCamera,
  Points,
  PointsMaterial,
  Raycaster,
  Scene,
  SphereGeometry,
  SRGBColorSpace,
  TorusGeometry,
  Vector2,
  Vector3,
  WebGLRenderer,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { FLESH, SPRINGS, strainColour } from "./colours";

const SIDES = 24;
/** Angles of the rings of the tip's cap. */
const CAP = [30, 60, 88].map((angle) => (angle * Math.PI) / 180);
/** Length of the pointer that draws the base's way [m]. */
const POINTER = 0.12;
/** Points of that way. */
const TRAIL = 600;
/** How near to the arm a finger takes it [pixels]. */
const REACH = 44;
const FLOOR = -0.62;
/** How far the camera stands from the arm [m], and what it sees at least to each side, and up and down. */
const DISTANCE = 1.35;
const ASIDE = 0.46;
const UPWARDS = 0.42;

export interface Hand {
  /** The arm was taken, or wants to be there: base angles [degrees]. */
  drag(theta: number, phi: number): void;
  release(): void;
}

/** The world's axes, z downwards, as three.js has them, y upwards. */
function place(x: number, y: number, z: number, out: Float32Array | number[], at: number): void {
  out[at] = x;
  out[at + 1] = -z;
  out[at + 2] = y;
}

/** The direction of an arm whose base is turned so [degrees], in the world. */
function direction(theta: number, phi: number): [number, number, number] {
  const [t, p] = [(theta * Math.PI) / 180, (phi * Math.PI) / 180];
  return [Math.sin(p), -Math.sin(t) * Math.cos(p), Math.cos(t) * Math.cos(p)];
}

export class ArmScene {
  readonly canvas: HTMLCanvasElement;
  private readonly renderer: WebGLRenderer;
  private readonly scene = new Scene();
  private readonly camera = new PerspectiveCamera(38, 1, 0.01, 10);
  private readonly controls: OrbitControls;
  private readonly base = new Group();
  private skin!: Mesh<BufferGeometry, MeshStandardMaterial>;
  private springs!: LineSegments;
  private readonly shadow: Mesh;
  private readonly water: Points;
  private readonly trail: Line<BufferGeometry, LineBasicMaterial>;
  private readonly orbit = new LineLoop(new BufferGeometry(), new LineBasicMaterial({ transparent: true, opacity: 0.75 }));
  private planes = 0;
  private joints: Float64Array<ArrayBufferLike> = new Float64Array(0);
  private centres = new Float32Array(0);
  private readonly still: boolean;
  /** The distance from the base at which the arm was taken, where on its sphere, and the finger. */
  private grabbed: { distance: number; at: Vector3; pointer: number } | null = null;

  constructor(canvas: HTMLCanvasElement, hand: Hand, still: boolean) {
    this.canvas = canvas;
    this.still = still;
    this.renderer = new WebGLRenderer({ canvas, antialias: true, alpha: true, powerPreference: "high-performance" });
    this.renderer.outputColorSpace = SRGBColorSpace;
    this.camera.position.set(0.6, -0.02, DISTANCE - 0.25);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.target.set(0, -0.13, 0);
    this.controls.enablePan = false;
    this.controls.minDistance = 0.5;
    this.controls.maxDistance = 2.2;
    this.controls.enableDamping = true;
    this.controls.maxPolarAngle = 0.62 * Math.PI;
    // Its own key handling would take the arrows from the base.

    this.scene.fog = new Fog(0x0b4a66, 1.1, 3.2);
    this.scene.add(new HemisphereLight(0xd8f4ff, 0x36505a, 1.7), new AmbientLight(0xffffff, 0.35));
    const sun = new DirectionalLight(0xfff4e0, 2.1);
    sun.position.set(0.6, 1.4, 0.8);
    // What looks at the arm lights it too: it hangs, and the sun stands high.
    const lamp = new DirectionalLight(0xffffff, 2.4);
    this.camera.add(lamp);
    this.scene.add(sun, this.camera);

    const metal = new MeshStandardMaterial({ color: 0xaebfc6, metalness: 0.2, roughness: 0.45 });
    const plate = new Mesh(new CylinderGeometry(0.024, 0.024, 0.008, 40), metal);
    plate.position.y = 0.004;
    const rod = new Mesh(new CylinderGeometry(0.0022, 0.0022, POINTER, 12), metal);
    rod.position.y = POINTER / 2;
    const tip = new Mesh(new SphereGeometry(0.006, 20, 16), new MeshStandardMaterial({ color: 0xff9628, roughness: 0.5 }));
    tip.position.y = POINTER;
    this.base.add(plate, rod, tip);
    const ring = new Mesh(new TorusGeometry(0.034, 0.0032, 14, 60), metal);
    ring.rotation.x = Math.PI / 2;
    this.scene.add(this.base, ring, this.orbit);

    const floor = new Mesh(
      new CircleGeometry(1.6, 72),
      new MeshStandardMaterial({ color: 0x6f8f86, roughness: 1, transparent: true, opacity: 0.5 }),
    );
    floor.rotation.x = -Math.PI / 2;
    floor.position.y = FLOOR;
    this.shadow = new Mesh(new BufferGeometry(), new MeshBasicMaterial({ color: 0x04202c, transparent: true, opacity: 0.32, side: DoubleSide, depthWrite: false }));
    this.shadow.position.y = FLOOR + 0.002;
    this.scene.add(floor, this.shadow);
    for (const radius of [0.2, 0.4, 0.6, 0.8, 1.0]) {
      const circle = new LineLoop(
        new BufferGeometry().setFromPoints(
          Array.from({ length: 96 }, (_, k) => new Vector3(radius * Math.cos((k * Math.PI) / 48), 0, radius * Math.sin((k * Math.PI) / 48))),
        ),
        new LineBasicMaterial({ color: 0xbfe3e6, transparent: true, opacity: 0.28 - 0.2 * radius }),
      );
      circle.position.y = FLOOR + 0.001;
      this.scene.add(circle);
    }

    // What drifts in the water; the same places every time.
    const drifting = new Float32Array(3 * 220);
    let seed = 7;
    const next = (): number => (seed = (seed * 48271) % 2147483647) / 2147483647;
    for (let k = 0; k < drifting.length; k += 3) {
      drifting[k] = 1.5 * (next() - 0.5);
      drifting[k + 1] = FLOOR + 1.3 * next();
      drifting[k + 2] = 1.5 * (next() - 0.7);
    }
    this.water = new Points(
      new BufferGeometry().setAttribute("position", new BufferAttribute(drifting, 3)),
      new PointsMaterial({ color: 0xe6fbff, size: 0.0055, transparent: true, opacity: 0.45, depthWrite: false }),
    );
    this.scene.add(this.water);

    const way = new BufferGeometry();
    way.setAttribute("position", new BufferAttribute(new Float32Array(3 * TRAIL), 3));
    this.trail = new Line(way, new LineBasicMaterial({ color: 0xff9628, transparent: true, opacity: 0.9 }));
    this.trail.frustumCulled = false;
    this.orbit.frustumCulled = false;
    this.scene.add(this.trail);

    this.listen(hand);
    new ResizeObserver(() => this.resize()).observe(canvas);
    this.resize();
  }

  /** Draws the cycle that the pointer shall follow, (points, 2) [degrees]. */
  setOrbit(orbit: Float64Array): void {
    const count = 256;
    const positions = new Float32Array(3 * count);
    for (let k = 0; k < count; k++) {
      const at = 2 * Math.floor((k * orbit.length) / 2 / count);
      this.pointerEnd(orbit[at]!, orbit[at + 1]!, positions, 3 * k);
    }
    this.orbit.geometry.dispose();
    this.orbit.geometry = new BufferGeometry().setAttribute("position", new BufferAttribute(positions, 3));
  }

  showTarget(shown: boolean): void {
    this.orbit.visible = shown;
  }

  /** Draws the way of the pointer: times and base angles [degrees], the last ones if there are many. */
  setTrail(past: readonly (readonly [number, number, number])[]): void {
    const way = this.trail.geometry.getAttribute("position") as BufferAttribute;
    const shown = past.slice(-TRAIL);
    for (const [k, [, theta, phi]] of shown.entries()) this.pointerEnd(theta, phi, way.array as Float32Array, 3 * k);
    way.needsUpdate = true;
    this.trail.geometry.setDrawRange(0, shown.length);
  }

  get held(): boolean {
    return this.grabbed !== null;
  }

  /** Where the middle of the arm is on the screen [pixels of the window]. */
  middle(): { x: number; y: number } {
    const at = 3 * Math.floor(this.planes / 2);
    const point = new Vector3(this.centres[at], this.centres[at + 1], this.centres[at + 2]).project(this.camera);
    const box = this.canvas.getBoundingClientRect();
    return { x: box.left + ((point.x + 1) / 2) * box.width, y: box.top + ((1 - point.y) / 2) * box.height };
  }

  /**
   * Takes a new pose: ends of the springs (planes, 4, 3) [m] in the world, strains (planes - 1, 4), and
   * base angles [degrees].
   */
  setPose(joints: Float64Array, lengths: Float64Array, restLength: number, theta: number, phi: number): void {
    const planes = joints.length / 12;
    if (planes !== this.planes) this.build(planes);
    this.joints = joints;
    this.updateSkin(lengths, restLength);
    const up = new Vector3();
    const end = new Float32Array(3);
    this.pointerEnd(theta, phi, end, 0);
    this.base.quaternion.setFromUnitVectors(new Vector3(0, 1, 0), up.set(end[0]!, end[1]!, end[2]!).normalize());
  }

  draw(time: number): void {
    if (!this.still) this.water.position.y = 0.02 * Math.sin(time * 0.3);
    this.controls.update();
    this.renderer.render(this.scene, this.camera);
  }

  private resize(): void {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (width === 0 || height === 0) return;
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    // Whatever the shape of the stage, the arm fits in it.
    const half = Math.max(UPWARDS, ASIDE / this.camera.aspect);
    this.camera.fov = (2 * Math.atan(half / DISTANCE) * 180) / Math.PI;
    this.camera.updateProjectionMatrix();
  }

  private pointerEnd(theta: number, phi: number, out: Float32Array, at: number): void {
    const [x, y, z] = direction(theta, phi);
    place(-POINTER * x, -POINTER * y, -POINTER * z, out, at);
  }

  private build(planes: number): void {
    this.planes = planes;
    const rings = planes + CAP.length;
    const index: number[] = [];
    for (let ring = 0; ring + 1 < rings; ring++) {
      for (let side = 0; side < SIDES; side++) {
        const [a, b] = [ring * SIDES + side, ring * SIDES + ((side + 1) % SIDES)];
        index.push(a, a + SIDES, b, b, a + SIDES, b + SIDES);
      }
    }
    const skin = new BufferGeometry();
    skin.setAttribute("position", new BufferAttribute(new Float32Array(3 * rings * SIDES), 3));
    skin.setAttribute("color", new BufferAttribute(new Float32Array(3 * rings * SIDES), 3));
    skin.setIndex(index);
    const springs = new BufferGeometry();
    springs.setAttribute("position", new BufferAttribute(new Float32Array(3 * 8 * (planes - 1)), 3));
    const colours = new Float32Array(3 * 8 * (planes - 1));
    const colour = new Color();
    for (let k = 0; k < 8 * (planes - 1); k++) {
      const [red, green, blue] = SPRINGS[Math.floor(k / 2) % 4]!;
      colour.setRGB(red / 255, green / 255, blue / 255, SRGBColorSpace).toArray(colours, 3 * k);
    }
    springs.setAttribute("color", new BufferAttribute(colours, 3));
    if (this.skin) {
      this.scene.remove(this.skin, this.springs);
      this.skin.geometry.dispose();
      this.springs.geometry.dispose();
    }
    this.skin = new Mesh(skin, new MeshStandardMaterial({ vertexColors: true, roughness: 0.55, side: DoubleSide }));
    this.springs = new LineSegments(springs, new LineBasicMaterial({ vertexColors: true, transparent: true, opacity: 0.95 }));
    this.skin.frustumCulled = false;
    this.springs.frustumCulled = false;
    this.shadow.geometry = skin;
    this.shadow.scale.set(1, 0, 1);
    this.shadow.frustumCulled = false;
    this.scene.add(this.skin, this.springs);
    this.centres = new Float32Array(3 * planes);
  }

  private updateSkin(lengths: Float64Array, restLength: number): void {
    const { joints, planes, centres } = this;
    const position = this.skin.geometry.getAttribute("position") as BufferAttribute;
    const colour = this.skin.geometry.getAttribute("color") as BufferAttribute;
    const [points, colours] = [position.array as Float32Array, colour.array as Float32Array];
    const lines = this.springs.geometry.getAttribute("position") as BufferAttribute;
    const ends = lines.array as Float32Array;
    const [rgb, shade] = [[0, 0, 0], new Color()];
    const strains = [0, 0, 0, 0];
    for (let plane = 0; plane < planes; plane++) {
      // The struts' middle: where joints 1 and 3, 2 and 4 meet.
      const at = 12 * plane;
      const [across, beside, middle] = [[0, 0, 0], [0, 0, 0], [0, 0, 0]];
      let [square, product] = [0, 0];
      for (let k = 0; k < 3; k++) {
        across[k] = joints[at + 6 + k]! - joints[at + k]!;
        beside[k] = joints[at + 3 + k]! - joints[at + k]!;
        square += across[k]! * across[k]!;
        product += across[k]! * beside[k]!;
      }
      for (let k = 0; k < 3; k++) middle[k] = joints[at + k]! + (product / square) * across[k]!;
      place(middle[0]!, middle[1]!, middle[2]!, centres, 3 * plane);
      // A ring takes the mean of the compartments above and below.
      for (let spring = 0; spring < 4; spring++) {
        const above = lengths[4 * Math.max(plane - 1, 0) + spring]!;
        const below = lengths[4 * Math.min(plane, planes - 2) + spring]!;
        strains[spring] = (above + below) / (2 * restLength) - 1;
      }
      for (let side = 0; side < SIDES; side++) {
        const turn = (4 * side) / SIDES;
        const one = Math.floor(turn);
        const angle = (Math.PI / 2) * (turn - one);
        const [first, second] = [3 * one, 3 * ((one + 1) % 4)];
        const [cosine, sine] = [Math.cos(angle), Math.sin(angle)];
        const to = 3 * (plane * SIDES + side);
        const point = [0, 1, 2].map(
          (k) => middle[k]! + cosine * (joints[at + first + k]! - middle[k]!) + sine * (joints[at + second + k]! - middle[k]!),
        );
        place(point[0]!, point[1]!, point[2]!, points, to);
        strainColour(cosine * cosine * strains[one]! + sine * sine * strains[(one + 1) % 4]!, FLESH, rgb);
        // Every other compartment is a little darker.
        const light = (plane % 2 === 0 ? 1 : 0.9) / 255;
        shade.setRGB(rgb[0]! * light, rgb[1]! * light, rgb[2]! * light, SRGBColorSpace).toArray(colours, to);
      }
    }
    this.cap(points, colours);
    for (let segment = 0; segment < 4 * (planes - 1); segment++) {
      const from = 12 * Math.floor(segment / 4) + 3 * (segment % 4);
      for (let end = 0; end < 2; end++) {
        const at = from + 12 * end;
        const plane = Math.floor(segment / 4) + end;
        // A hair outside the skin.
        const out = [0, 1, 2].map((k) => joints[at + k]!);
        const to = 6 * segment + 3 * end;
        place(out[0]!, out[1]!, out[2]!, ends, to);
        for (let k = 0; k < 3; k++) ends[to + k]! += 0.05 * (ends[to + k]! - centres[3 * plane + k]!);
      }
    }
    position.needsUpdate = colour.needsUpdate = lines.needsUpdate = true;
    this.skin.geometry.computeVertexNormals();
  }

  /** Rounds the tip. */
  private cap(points: Float32Array, colours: Float32Array): void {
    const last = this.planes - 1;
    const ring = 3 * last * SIDES;
    const centre = new Vector3().fromArray(this.centres, 3 * last);
    const inner = new Vector3().fromArray(this.centres, 3 * (last - 1));
    const normal = centre.clone().sub(inner).normalize();
    const way = new Vector3();
    for (const [k, angle] of CAP.entries()) {
      for (let side = 0; side < SIDES; side++) {
        const [from, to] = [ring + 3 * side, ring + 3 * ((k + 1) * SIDES + side)];
        way.fromArray(points, from).sub(centre);
        const radius = way.length();
        way.multiplyScalar(Math.cos(angle)).addScaledVector(normal, radius * Math.sin(angle)).add(centre);
        way.toArray(points, to);
        colours.copyWithin(to, from, from + 3);
      }
    }
  }

  private listen(hand: Hand): void {
    const ray = new Raycaster();
    const { canvas } = this;
    const aim = (event: PointerEvent): { x: number; y: number; width: number; height: number } => {
      const box = canvas.getBoundingClientRect();
      const [x, y] = [event.clientX - box.left, event.clientY - box.top];
      ray.setFromCamera(new Vector2((2 * x) / box.width - 1, 1 - (2 * y) / box.height), this.camera);
      return { x, y, width: box.width, height: box.height };
    };
    /** Turns the base so that what was taken is under the pointer, on its sphere about the base. */
    const lead = (): void => {
      if (!this.grabbed) return;
      const { origin, direction: along } = ray.ray;
      const nearest = -origin.dot(along);
      const square = origin.lengthSq() - nearest * nearest;
      const depth = this.grabbed.distance ** 2 - square;
      // Of the two sides of the sphere the one where the arm is; beside it, the nearest point of its rim.
      const half = depth > 0 ? Math.sqrt(depth) : 0;
      const sides = [nearest - half, nearest + half].map((far) => origin.clone().addScaledVector(along, far).normalize());
      const [near, behind] = [sides[0]!, sides[1]!];
      const point = near.distanceToSquared(this.grabbed.at) <= behind.distanceToSquared(this.grabbed.at) ? near : behind;
      this.grabbed.at.copy(point);
      const [x, y, z] = [point.x, point.z, -point.y];
      const phi = (Math.asin(Math.max(-1, Math.min(1, x))) * 180) / Math.PI;
      const theta = (Math.atan2(-y, z) * 180) / Math.PI;
      hand.drag(Math.max(-100, Math.min(100, theta)), phi);
    };
    canvas.addEventListener(
      "pointerdown",
      (event) => {
        const { x, y, width, height } = aim(event);
        let [best, distance] = [REACH, 0];
        const [point, at] = [new Vector3(), new Vector3()];
        for (let plane = 1; plane < this.planes; plane++) {
          point.fromArray(this.centres, 3 * plane);
          const away = point.length();
          const there = point.clone().normalize();
          point.project(this.camera);
          const pixels = Math.hypot(((point.x + 1) / 2) * width - x, ((1 - point.y) / 2) * height - y);
          if (pixels < best) {
            [best, distance] = [pixels, away];
            at.copy(there);
          }
        }
        if (distance === 0) return;
        this.grabbed = { distance, at, pointer: event.pointerId };
        this.controls.enabled = false;
        canvas.setPointerCapture(event.pointerId);
        canvas.classList.add("held");
        lead();
      },
      { capture: true },
    );
    canvas.addEventListener("pointermove", (event) => {
      if (this.grabbed?.pointer !== event.pointerId) return;
      aim(event);
      lead();
    });
    const end = (event: PointerEvent): void => {
      if (this.grabbed?.pointer !== event.pointerId) return;
      this.grabbed = null;
      this.controls.enabled = true;
      canvas.classList.remove("held");
      hand.release();
    };
    canvas.addEventListener("pointerup", end);
    canvas.addEventListener("pointercancel", end);
  }
}
