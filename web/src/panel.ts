// The side panel of the page: lists size, error bound, device and other properties of a file, and the
// keyboard keys. Strings of a file are inserted as text, never as HTML.
import type { Opened } from "./engine";

/** What a program knows besides the file: keys of `touchfield info --json` and `compare --json`. */
export type Given = Record<string, unknown> | null;

export const millimetres = (m: number): string => {
  const mm = 1000 * m;
  return Math.abs(mm) >= 10000 ? `${(mm / 1000).toFixed(1)} m` : `${Math.abs(mm) >= 100 ? mm.toFixed(0) : mm.toFixed(1)} mm`;
};

const bytes = (n: number): string => (n < 10000 ? `${n} B` : n < 1e7 ? `${(n / 1000).toFixed(1)} kB` : `${(n / 1e6).toFixed(1)} MB`);
const short = (n: number): string => (n !== 0 && (Math.abs(n) < 1e-3 || Math.abs(n) >= 1e5) ? n.toExponential(2) : String(+n.toPrecision(4)));

/** A number of more digits than anybody reads, as programs write them. */
const LONG_NUMBER = /\b\d+\.\d{6,}(?:e[+-]?\d+)?/gi;

function row(list: HTMLElement, name: string, value: string): HTMLElement {
  const [term, description] = [document.createElement("dt"), document.createElement("dd")];
  term.textContent = name;
  description.textContent = value;
  list.append(term, description);
  return description;
}

const KNOWN: [string, string, (n: number) => string][] = [
  ["worst_mask_ratio", "largest error / bound", short],
  ["nmse_db", "NMSE", (n) => `${n.toFixed(1)} dB`],
  ["bits_per_supported_voxel", "a voxel with force", (n) => `${short(n)} bit`],
  ["hand_vibration_mn", "vibration of coding", (n) => `${short(n)} mN`],
];

const bits = (n: number): string => (n < 1e4 ? `${Math.round(n)} bit` : n < 1e7 ? `${+(n / 1e3).toPrecision(4)} kbit` : `${+(n / 1e6).toPrecision(4)} Mbit`);
const percent = (fraction: number, digits: number): string => `${+(100 * fraction).toPrecision(digits)} %`;

/** What the medium holds in bits, and what each device renders of it. */
function information(list: HTMLElement, given: Record<string, unknown>): void {
  if (typeof given.entropy_voxel_bits !== "number") return void row(list, "entropy, capacity", "not computed");
  row(list, "entropy of a voxel", `${short(given.entropy_voxel_bits)} bit`);
  row(list, "entropy of a frame", bits(given.entropy_frame_bits as number));
  for (const [name, own] of Object.entries(given.capacity as Record<string, Record<string, number>>)) {
    row(list, `capacity, ${name}`, `${bits(own.capacity_bits!)} a frame`);
    row(list, "rendered, lost", `${percent(own.wmr!, 3)}, ${percent(own.hil!, 5)}`);
  }
}

/** Caption of the picture of the difference. */
export function differenceText(given: Given, hasBodies: boolean): string {
  const bodies = hasBodies && typeof given?.place_tolerance_um === "number" ? ` Positions of bodies are exact to ${short(given.place_tolerance_um)} µm, which adds to the difference.` : "";
  const none = given?.mode === "nmse" ? " (this file guarantees none)" : given?.masking ? " (larger with masking)" : "";
  const scale = `|decoded − source| as a fraction of the error bound max(F₀, k |F|): 1 is the bound${none}, red is above it.`;
  const source = `The source is exact to ± ${short(Number(given?.source_share ?? 0))} on this scale.`;
  return `${scale} Cones point where the decoded field pushes more. ${source}${bodies}`;
}

export function figuresOf(list: HTMLElement, provenance: HTMLElement, opened: Opened, given: Given, isPins: boolean): void {
  const { head, records } = opened;
  list.replaceChildren();
  const samples = head.shape.reduce((a, b) => a * b, 1) * head.frames;
  row(list, "size", bytes(records.size));
  row(list, "as plain numbers", `${bytes(12 * samples)}, 1 : ${Math.round((12 * samples) / records.size).toLocaleString("en")}`);
  const isExact = given?.mode === "lossless";
  const around = typeof given?.masking === "number" ? `, and ${percent(given.masking, 3)} of the mean force around` : "";
  const threshold = isPins ? `${percent(head.threshold / head.peak, 2)} of the travel` : `${short(head.threshold)} N`;
  const absolute = head.threshold > 0 ? `error ≤ ${threshold}` : "none";
  const relative = `error ≤ ${percent(head.weber, 3)} or ${threshold}${around}`;
  row(list, "error bound", isExact ? "exact, to the bit" : head.weber > 0 ? relative : absolute);
  if (typeof given?.frames_of === "number") row(list, "shown", `the first of ${short(given.frames_of)} frames`);
  if (given?.promise_kept !== undefined && given.promise_kept !== null) row(list, "error bound holds", given.promise_kept ? "yes" : "no");
  for (const [key, name, format] of KNOWN) if (typeof given?.[key] === "number") row(list, name, format(given[key] as number));
  if (given) information(list, given);
  if (typeof given?.source_bytes === "number") row(list, "embedded source", bytes(given.source_bytes));
  row(list, "device", records.device || "–");
  row(list, isPins ? "a pin is fully up at" : "largest force", `${short(head.peak)} N`);
  row(list, "lattice", head.shape.join(" × "));
  row(list, "spacing", `${head.spacing.map((m) => +(1000 * m).toPrecision(3)).join(" × ")} mm`);
  if (head.frames > 1) row(list, "frames", `${head.frames} at ${short(head.rate)} Hz`);
  if (head.objects) row(list, "bodies", records.objects.slice(0, 12).join(", ") + (records.objects.length > 12 ? ", …" : ""));
  row(list, "1 m of the scene", `${head.scale < 1e-4 ? `${short(1e6 * head.scale)} µm` : millimetres(head.scale)} of the hand`);
  if (head.friction) row(list, "friction", short(head.friction));
  row(list, "axes", records.axes || "–");
  row(list, "coder", records.coder);
  row(list, "memory of the page", `${Math.round(opened.memory / 2 ** 20)} of at most 1024 MiB`);
  row(list, "the hand", "starts").id = "hand";
  provenance.replaceChildren();
  for (const [key, value] of records.provenance) row(provenance, key, value.replaceAll(LONG_NUMBER, (digits) => short(Number(digits))));
  (provenance.closest("details") as HTMLElement).hidden = !records.provenance.length;
}

const KEYS: [string, string][] = [
  ["arrows, Page Up, Page Down", "move the probe: right, left, up, down, away, towards you; with Shift finely"],
  ["Space", "play or pause; , and . one frame back or on"],
  ["Home, End", "to the first or the last frame"],
  ["f", "follow the surface: the probe stays on it, arrows move as on a map, and heights are spoken"],
  ["n, b", "mark this place; go back to the mark, and from there to here"],
  ["l", "put this time and place into the address of the page"],
  ["[ and ]", "move the slice; x, y, z lay it across that axis; c cuts the surface open"],
  ["< and >", "press less or more deeply"],
  ["j, k", "to the strongest force, to the voxel with the largest error"],
  ["m, v", "force as sound, as rumble and vibration"],
  ["e", "decoded, source, difference, where the source is there"],
  ["s", "scan: reads a line of the field through the probe, left to right, as sound"],
  ["t", "speak what is under the probe again"],
  ["a, d, w, q, +, -, r", "turn the view, nearer, farther, reset"],
  ["h", "high contrast"],
  ["o, p", "open a file or a depth picture; save the frame that is shown"],
  ["game pad", "stick: move; cross: a step; A: speak; B: follow the surface; Y: strongest force; shoulders: depth"],
  ["pointer", "hover: feel; drag: turn; wheel: nearer; Shift and wheel: deeper; the slice by its handle"],
  ["fingers, pen", "one: feel, and a pen's pressure is depth; two: turn and zoom"],
];

export function keyList(into: HTMLElement): void {
  const list = document.createElement("dl");
  for (const [keys, description] of KEYS) row(list, keys, description);
  into.replaceChildren(list);
}
