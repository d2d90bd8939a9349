/** The module of the arm: the one with vectors of 128 bits where the browser has them. */

import type { Octoarm } from "../wasm/simd/octoarm_web.js";

export type { Octoarm };
export type Kind = "simd" | "plain";
export type Driver = "hand" | "teacher" | "readout" | "network";

/** A module that holds one instruction of vectors: `i8x16.popcnt`. */
const VECTORS = new Uint8Array([
  0, 97, 115, 109, 1, 0, 0, 0, 1, 5, 1, 96, 0, 1, 123, 3, 2, 1, 0, 10, 10, 1, 8, 0, 65, 0, 253, 15, 253, 98, 11,
]);

export interface Physics {
  kind: Kind;
  memory: WebAssembly.Memory;
  Octoarm: typeof Octoarm;
  preset(name: string): string;
  run(body: string, angles: Float64Array): Float64Array;
}

/** Loads the physics; `kind` asks for one of the two modules. */
export async function loadPhysics(kind?: string | null): Promise<Physics> {
  const simd = kind !== "plain" && WebAssembly.validate(VECTORS);
  const module = simd
    ? await import("../wasm/simd/octoarm_web.js")
    : await import("../wasm/plain/octoarm_web.js");
  const { memory } = await module.default();
  return {
    kind: simd ? "simd" : "plain",
    memory,
    Octoarm: module.Octoarm as typeof Octoarm,
    preset: module.preset,
    run: module.run,
  };
}

/** A look at numbers in the module's memory, which holds until its next call. */
export function view(physics: Physics, pointer: number, length: number): Float64Array {
  return new Float64Array(physics.memory.buffer, pointer, length);
}
