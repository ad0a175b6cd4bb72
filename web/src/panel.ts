// The side panel of the page: lists size, error bound, device and other properties of a file, and the
// keyboard keys. Strings of a file are inserted as text, never as HTML.
import type { Opened } from "./engine";

/** What a program knows beyond the file, as `touchfield info --json` and `compare --json` tell it. */
export type Given = Record<string, unknown> | null;

export const millimetres = (m: number): string => {
  const mm = 1000 * m;
  return Math.abs(mm) >= 10000 ? `${(mm / 1000).toFixed(1)} m` : `${Math.abs(mm) >= 100 ? mm.toFixed(0) : mm.toFixed(1)} mm`;
};

const bytes = (n: number): string => (n < 10000 ? `${n} B` : n < 1e7 ? `${(n / 1000).toFixed(1)} kB` : `${(n / 1e6).toFixed(1)} MB`);
const short = (n: number): string => (n !== 0 && (Math.abs(n) < 1e-3 || Math.abs(n) >= 1e5) ? n.toExponential(2) : String(+n.toPrecision(4)));

function row(list: HTMLElement, name: string, value: string): void {
  const [term, told] = [document.createElement("dt"), document.createElement("dd")];
  term.textContent = name;
  told.textContent = value;
  list.append(term, told);
}

const KNOWN: [string, string, (n: number) => string][] = [
  ["worst_mask_ratio", "worst error / allowed", short],
  ["nmse_db", "NMSE", (n) => `${n.toFixed(1)} dB`],
  ["bits_per_supported_voxel", "a voxel with force", (n) => `${short(n)} bit`],
  ["hand_vibration_mn", "vibration of coding", (n) => `${short(n)} mN`],
];

const bits = (n: number): string => (n < 1e4 ? `${Math.round(n)} bit` : n < 1e7 ? `${+(n / 1e3).toPrecision(4)} kbit` : `${+(n / 1e6).toPrecision(4)} Mbit`);
const percent = (share: number, digits: number): string => `${+(100 * share).toPrecision(digits)} %`;

/** What the medium holds in bits, and what each device renders of it. */
function information(list: HTMLElement, given: Record<string, unknown>): void {
  if (typeof given.entropy_voxel_bits !== "number") return row(list, "entropy, capacity", "not computed");
  row(list, "entropy of a voxel", `${short(given.entropy_voxel_bits)} bit`);
  row(list, "entropy of a frame", bits(given.entropy_frame_bits as number));
  for (const [name, own] of Object.entries(given.capacity as Record<string, Record<string, number>>)) {
    row(list, `capacity, ${name}`, `${bits(own.capacity_bits!)} a frame`);
    row(list, "rendered, lost", `${percent(own.wmr!, 3)}, ${percent(own.hil!, 5)}`);
  }
}

/** What a picture of the difference shows. */
export function differenceWords(given: Given, hasBodies: boolean): string {
  const place = hasBodies && typeof given?.place_tolerance_um === "number" ? ` Bodies may lie ${short(given.place_tolerance_um)} µm elsewhere, which counts here too.` : "";
  const none = given?.mode === "nmse" ? " (this file gives no such promise)" : given?.masking ? " (with masking more is allowed)" : "";
  return `|decoded − source| as a share of what is allowed, max(F₀, k |F|): 1 is the promise${none}, red is beyond it. Cones point where the decoded field pushes more. The source is told to ± ${short(Number(given?.source_share ?? 0))} on this scale.${place}`;
}

export function figuresOf(list: HTMLElement, story: HTMLElement, opened: Opened, given: Given): void {
  const { head, records } = opened;
  list.replaceChildren();
  const samples = head.shape.reduce((a, b) => a * b, 1) * head.frames;
  row(list, "size", bytes(records.size));
  row(list, "as plain numbers", `${bytes(12 * samples)}, 1 : ${Math.round((12 * samples) / records.size).toLocaleString("en")}`);
  const isExact = given?.mode === "lossless";
  const around = typeof given?.masking === "number" ? `, and ${percent(given.masking, 3)} of the mean force around` : "";
  row(list, "promise", isExact ? "exact, to the bit" : head.weber > 0 ? `error ≤ ${+(100 * head.weber).toPrecision(3)} % or ${head.threshold} N${around}` : head.threshold > 0 ? `error ≤ ${head.threshold} N` : "none");
  if (typeof given?.frames_of === "number") row(list, "shown", `the first of ${given.frames_of} frames`);
  if (given?.promise_kept !== undefined && given.promise_kept !== null) row(list, "promise holds", given.promise_kept ? "yes" : "no");
  for (const [key, name, words] of KNOWN) if (typeof given?.[key] === "number") row(list, name, words(given[key] as number));
  if (given) information(list, given);
  if (typeof given?.source_bytes === "number") row(list, "source beside it", bytes(given.source_bytes));
  row(list, "device", records.device || "–");
  row(list, "largest force", `${short(head.peak)} N`);
  row(list, "lattice", head.shape.join(" × "));
  row(list, "spacing", `${head.spacing.map((m) => +(1000 * m).toPrecision(3)).join(" × ")} mm`);
  if (head.frames > 1) row(list, "frames", `${head.frames} at ${short(head.rate)} Hz`);
  if (head.objects) row(list, "bodies", records.objects.slice(0, 12).join(", ") + (records.objects.length > 12 ? ", …" : ""));
  row(list, "1 m of the scene", `${short(head.scale)} m of the hand`);
  if (head.friction) row(list, "friction", short(head.friction));
  row(list, "axes", records.axes || "–");
  row(list, "coder", records.coder);
  row(list, "page's memory", `${Math.round(opened.memory / 2 ** 20)} of at most 1024 MiB`);
  story.replaceChildren();
  for (const [key, value] of records.story) row(story, key, value);
  (story.closest("details") as HTMLElement).hidden = !records.story.length;
}

const KEYS: [string, string][] = [
  ["arrows, Page Up, Page Down", "move the probe: right, left, up, down, away, towards you; with Shift finely"],
  ["Space", "play or pause; , and . one frame back or on"],
  ["[ and ]", "move the slice; x, y, z lay it across that axis; c cuts the surface open"],
  ["< and >", "press less or more deeply"],
  ["j, k", "to the strongest place, to the worst voxel"],
  ["m, v", "force as sound, as rumble and vibration"],
  ["e", "decoded, source, difference, where the source is there"],
  ["s", "scan: reads a line of the field through the probe, left to right, as sound"],
  ["t", "tell what is under the probe again"],
  ["a, d, w, q, +, -, r", "turn the view, nearer, farther, back to the begin"],
  ["h", "high contrast"],
  ["o, p", "open a file; save the frame that is shown as one"],
  ["pointer", "hover: feel; drag: turn; wheel: nearer; Shift and wheel: deeper; the slice by its handle"],
  ["fingers, pen", "one: feel, and a pen's pressure is depth; two: turn and zoom"],
];

export function keyList(into: HTMLElement): void {
  const list = document.createElement("dl");
  for (const [keys, words] of KEYS) row(list, keys, words);
  into.replaceChildren(list);
}
