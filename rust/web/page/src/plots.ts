/** The flat pictures: phase portrait, strains and weights. */

import { type Rgb, SPRINGS, strainColour } from "./colours";

/** Seconds of the base's way that the portrait shows. */
const PAST = 2.5;

/** A colour of the style sheet, as it is where the canvas stands. */
function token(canvas: HTMLCanvasElement, name: string): string {
  return getComputedStyle(canvas).getPropertyValue(name).trim();
}

/** A canvas as large as it is shown, in pixels of the screen, and its pen in CSS pixels; wiped. */
function pen(canvas: HTMLCanvasElement): [CanvasRenderingContext2D, number, number] | null {
  const { clientWidth: width, clientHeight: height } = canvas;
  const context = canvas.getContext("2d");
  if (!context || width === 0 || height === 0) return null;
  const ratio = Math.min(window.devicePixelRatio, 2);
  const [w, h] = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return [context, width, height];
}

/** A closed curve of (points, 2). */
function curve(context: CanvasRenderingContext2D, points: ArrayLike<number>, place: (x: number, y: number) => [number, number]): void {
  context.beginPath();
  const step = Math.max(2, 2 * Math.floor(points.length / 2 / 256));
  for (let k = 0; k < points.length; k += step) {
    const [x, y] = place(points[k]!, points[k + 1]!);
    if (k === 0) context.moveTo(x, y);
    else context.lineTo(x, y);
  }
  context.closePath();
  context.stroke();
}

/** A small picture of a cycle alone. */
export function drawThumbnail(canvas: HTMLCanvasElement, orbit: ArrayLike<number>): void {
  const drawn = pen(canvas);
  if (!drawn) return;
  const [context, width, height] = drawn;
  let most = 0;
  for (let k = 0; k < orbit.length; k++) most = Math.max(most, Math.abs(orbit[k]!));
  const scale = (0.5 * Math.min(width, height) - 3) / most;
  context.strokeStyle = token(canvas, "--text");
  context.lineWidth = 1.6;
  curve(context, orbit, (x, y) => [width / 2 + scale * x, height / 2 - scale * y]);
}

/** Where the base was and is, in the plane of its two angles. */
export class Portrait {
  /** Time [s] and base angles [degrees] of the last seconds. */
  readonly past: [number, number, number][] = [];
  private orbit: Float64Array = new Float64Array(0);
  private range = 60;

  constructor(private readonly canvas: HTMLCanvasElement) {}

  /** The target (points, 2) [degrees]; none for a hand. */
  setOrbit(orbit: Float64Array | null): void {
    this.orbit = orbit ?? new Float64Array(0);
    let most = 0;
    for (const angle of this.orbit) most = Math.max(most, Math.abs(angle));
    this.range = most > 0 ? 1.35 * most : 80;
    this.clear();
  }

  clear(): void {
    this.past.length = 0;
  }

  add(time: number, theta: number, phi: number): void {
    this.past.push([time, theta, phi]);
    while (this.past.length > 0 && this.past[0]![0] < time - PAST) this.past.shift();
  }

  draw(): void {
    const drawn = pen(this.canvas);
    if (!drawn) return;
    const [context, width, height] = drawn;
    const scale = (0.5 * Math.min(width, height) - 6) / this.range;
    const place = (x: number, y: number): [number, number] => [width / 2 + scale * x, height / 2 - scale * y];
    context.lineWidth = 1;
    context.strokeStyle = token(this.canvas, "--line");
    context.beginPath();
    context.moveTo(0, height / 2);
    context.lineTo(width, height / 2);
    context.moveTo(width / 2, 0);
    context.lineTo(width / 2, height);
    context.stroke();
    context.fillStyle = token(this.canvas, "--muted");
    context.font = "12px system-ui, sans-serif";
    context.fillText("θ", width - 14, height / 2 - 6);
    context.fillText("φ", width / 2 + 6, 14);
    context.fillText(`±${Math.round(this.range)}°`, 6, height - 8);
    if (this.orbit.length > 0) {
      context.strokeStyle = token(this.canvas, "--target");
      context.lineWidth = 5;
      context.lineJoin = "round";
      curve(context, this.orbit, place);
    }
    context.strokeStyle = token(this.canvas, "--base");
    context.lineWidth = 2;
    for (let k = 1; k < this.past.length; k++) {
      const [[, a, b], [time, c, d]] = [this.past[k - 1]!, this.past[k]!];
      context.globalAlpha = Math.max(0.05, 1 - (this.past.at(-1)![0] - time) / PAST);
      context.beginPath();
      context.moveTo(...place(a, b));
      context.lineTo(...place(c, d));
      context.stroke();
    }
    context.globalAlpha = 1;
    const now = this.past.at(-1);
    if (now) {
      context.fillStyle = token(this.canvas, "--base");
      context.beginPath();
      context.arc(...place(now[1], now[2]), 5, 0, 2 * Math.PI);
      context.fill();
    }
  }
}

/** Strains of the springs (compartments, 4): a row for each of the four, the base at the left. */
export function drawStrain(canvas: HTMLCanvasElement, lengths: Float64Array, restLength: number): void {
  const drawn = pen(canvas);
  if (!drawn) return;
  const [context, width, height] = drawn;
  const columns = lengths.length / 4;
  const ground = token(canvas, "--cell").split(" ").map(Number) as unknown as Rgb;
  const [left, gap] = [10, 1.5];
  const [w, h] = [(width - left) / columns, height / 4];
  const rgb = [0, 0, 0];
  for (let spring = 0; spring < 4; spring++) {
    context.fillStyle = `rgb(${SPRINGS[spring]!.join(" ")})`;
    context.fillRect(0, spring * h + gap, 4, h - 2 * gap);
    for (let column = 0; column < columns; column++) {
      strainColour(lengths[4 * column + spring]! / restLength - 1, ground, rgb);
      context.fillStyle = `rgb(${rgb.map(Math.round).join(" ")})`;
      context.fillRect(left + column * w, spring * h + gap, Math.max(w - gap, 1), h - 2 * gap);
    }
  }
}

/** Weights (springs, 2): those of θ upwards from the upper line, those of φ about the lower one. */
export function drawWeights(canvas: HTMLCanvasElement, weights: Float64Array): void {
  const drawn = pen(canvas);
  if (!drawn) return;
  const [context, width, height] = drawn;
  const springs = weights.length / 2;
  let most = 0;
  for (const weight of weights) most = Math.max(most, Math.abs(weight));
  const w = (width - 16) / springs;
  context.font = "12px system-ui, sans-serif";
  for (let output = 0; output < 2; output++) {
    const middle = (height * (1 + 2 * output)) / 4;
    context.fillStyle = token(canvas, "--muted");
    context.fillText(output === 0 ? "θ" : "φ", 0, middle + 4);
    context.fillRect(14, middle - 0.5, width - 14, 1);
    for (let spring = 0; spring < springs; spring++) {
      const weight = weights[2 * spring + output]!;
      // Few weights are large: the bars go with the square root.
      const tall = Math.sqrt(Math.abs(weight) / most) * (height / 4 - 3) * Math.sign(weight);
      context.fillStyle = token(canvas, output === 0 ? "--accent" : "--base");
      context.fillRect(16 + spring * w, tall > 0 ? middle - tall : middle, Math.max(w - 1, 1), Math.abs(tall));
    }
  }
}
