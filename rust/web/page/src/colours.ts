/** What colours mean, as in the pictures of octoarm_env.rendering. */

export type Rgb = readonly [number, number, number];

/** Springs 1 to 4, told apart by the colour-blind too (after Okabe and Ito). */
export const SPRINGS: readonly Rgb[] = [
  [240, 228, 66],
  [86, 180, 233],
  [0, 190, 130],
  [213, 80, 0],
];
export const FLESH: Rgb = [248, 160, 132];
const SHORTER: Rgb = [59, 90, 235];
const LONGER: Rgb = [210, 24, 44];
const STRONGEST = 0.2;

/** The colour of a strain on a ground: it goes with the square root, and is strongest at 20 %. */
export function strainColour(strain: number, ground: Rgb, out: number[]): void {
  const share = Math.sqrt(Math.min(Math.abs(strain) / STRONGEST, 1));
  const end = strain < 0 ? SHORTER : LONGER;
  for (let k = 0; k < 3; k++) out[k] = ground[k]! + share * (end[k]! - ground[k]!);
}
