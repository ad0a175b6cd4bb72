// The relief of a picture of depth: where its pixels and the lattice lie, and what the page reports of it. The rule is that of
// `touchfield encode --reading height`; relief.h computes the forces.
import { Fault } from "./container";
import type { Triple } from "./engine";
import type { DepthPicture } from "./picture";

/** A picture with its placement in the workspace. */
export interface Relief {
  depth: Float32Array<ArrayBuffer>;
  /** The numbers of `relief_request` in relief.h. */
  numbers: Float64Array;
  /** Provenance that the file stores. */
  provenance: [string, string][];
  /** What was done, for the status line. */
  report: string;
}

/** Error bound of a first file, as that of `touchfield encode`. */
export const DEFAULT_BOUND = { weber: 0.1, threshold: 0.05 };

const SIDE = 128; // samples along each axis of the workspace
const WORKSPACE_M: Triple = [0.16, 0.12, 0.07]; // of the Phantom Omni
const MARGIN = 0.05; // on every side, of the shortest one
const STIFFNESS_N_PER_M = 500;
const FORCE_MAX_N = 3.3;
const FLOOR = 0.01; // forces below this fraction of the largest are dropped
const RATE_HZ = 30;
const FOCAL_WIDTHS = 525 / 640; // focal length of a PrimeSense camera, in widths of its picture
const EDGE = 0.05; // of the median depth: a larger jump between neighbours is an edge

interface Depths {
  unknown: number;
  low: number;
  high: number;
  median: number;
}

/** The median of float32 values above 0, as NumPy has it; their bits are in the order of the values. */
function medianOf(values: Float32Array<ArrayBuffer>, known: number): number {
  const bits = new Uint32Array(values.buffer, values.byteOffset, values.length);
  const ranked = (rank: number): number => {
    const high = new Uint32Array(1 << 16);
    const low = new Uint32Array(1 << 16);
    for (const b of bits) if (b) high[b >>> 16]!++;
    let top = 0;
    for (; rank >= high[top]!; top++) rank -= high[top]!;
    for (const b of bits) if (b && b >>> 16 === top) low[b & 0xffff]!++;
    let end = 0;
    for (; rank >= low[end]!; end++) rank -= low[end]!;
    return new Float32Array(Uint32Array.of(top * 65536 + end).buffer)[0]!;
  };
  const upper = ranked(known >> 1);
  return known & 1 ? upper : Math.fround(Math.fround(ranked((known >> 1) - 1) + upper) / 2);
}

function depthsOf(depth: Float32Array<ArrayBuffer>): Depths {
  let [known, low, high] = [0, Infinity, 0];
  for (const z of depth) {
    if (!z) continue;
    known++;
    low = Math.min(low, z);
    high = Math.max(high, z);
  }
  if (!known) throw new Fault("depth picture", "no pixel with depth; a surface needs some. Check the file", null);
  return { unknown: depth.length - known, low, high, median: medianOf(depth, known) };
}

const metres = (m: number): string => (m >= 1000 || m < 0.001 ? m.toExponential(2) : String(+m.toPrecision(3)));
const count = (n: number): string => n.toLocaleString("en");

/** Place a picture in the workspace: its pixels are spaced as at the median depth, and its box fits, with a margin. */
export function reliefOf({ width, height, depth, sample }: DepthPicture, name: string): Relief {
  const { unknown, low, high, median } = depthsOf(depth);
  const focal = FOCAL_WIDTHS * width;
  const middle = [(width - 1) / 2, (height - 1) / 2] as const;
  const step = median / focal;
  const start = middle.map((n) => (-n / focal) * median) as [number, number];
  const corners: [number, number][] = [[start[0], start[0] + step * (width - 1)], [start[1], start[1] + step * (height - 1)], [low, high]];
  const margin = MARGIN * Math.min(...WORKSPACE_M);
  const scale = Math.min(...corners.map(([from, to], n) => (to > from ? (WORKSPACE_M[n]! - 2 * margin) / (to - from) : Infinity)));
  const spacing = WORKSPACE_M.map((m) => m / SIDE);
  const origin = WORKSPACE_M.map((m, n) => -m / 2 + spacing[n]! / 2);
  const offset = corners.map(([from, to]) => from + (to - from) / 2);
  const pixels = [start[0], step, start[1], step, EDGE * median] as const;
  const numbers = Float64Array.of(width, height, ...spacing, ...origin, scale, ...offset, ...pixels, STIFFNESS_N_PER_M, FORCE_MAX_N, FLOOR * FORCE_MAX_N, RATE_HZ);
  const facts = `${width} × ${height} pixels (${sample}), depth ${metres(low)} to ${metres(high)} m, ${unknown ? count(unknown) : "no"} ${unknown === 1 ? "pixel" : "pixels"} without depth`;
  const clean = name.replaceAll(/[\0-\x1f\x7f-\x9f]/g, "\ufffd").slice(0, 80);
  const camera = `focal length ${+focal.toPrecision(6)} pixels (assumed), centre ${middle.join(", ")}`;
  const provenance: [string, string][] = [
    ["source", `${clean}, recorded by the page`], ["picture", facts], ["camera", camera],
    ["reading", "height map, solid behind the surface"], ["placement", `scale ${scale}, offset_m ${offset.join(", ")}`],
  ];
  return { depth, numbers, provenance, report: `Recorded ${clean}: ${facts}, grid ${SIDE} × ${SIDE} × ${SIDE}` };
}
