// Draws the time line: a ruler, a lane for each track (its strongest actuator over time, and the strength by regions), and a
// lane of all actuators of the array. What moves while the movie plays lies above the canvases.
import { TABLE } from "./colour";
import { MAX_PERCENT, percentAt, type TrackEdits } from "./timeline_edits";
import { FULL, type Track } from "./timeline_track";

/** The part of the movie that is shown, seconds. */
export interface Span {
  from: number;
  to: number;
}

const STEPS_S = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600];
const TICK_PX = 80;
const MARGIN_PX = 3;

export const clockText = (seconds: number, digits = 2): string => {
  const [minutes, rest] = [Math.floor(seconds / 60), seconds % 60];
  return `${minutes}:${rest.toFixed(digits).padStart(digits ? digits + 3 : 2, "0")}`;
};

/** A canvas in the pixels of the screen, cleared; null where it is not shown. */
function prepared(canvas: HTMLCanvasElement): { context: CanvasRenderingContext2D; width: number; height: number } | null {
  const { clientWidth: width, clientHeight: height } = canvas;
  const context = width && height ? canvas.getContext("2d") : null;
  if (!context) return null;
  const ratio = devicePixelRatio || 1;
  [canvas.width, canvas.height] = [Math.round(width * ratio), Math.round(height * ratio)];
  context.scale(ratio, ratio);
  return { context, width, height };
}

const colour = (name: string): string => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

export function drawRuler(canvas: HTMLCanvasElement, span: Span): void {
  const surface = prepared(canvas);
  if (!surface) return;
  const { context, width, height } = surface;
  const length = span.to - span.from;
  const step = STEPS_S.find((s) => (s / length) * width >= TICK_PX) ?? STEPS_S.at(-1)!;
  context.fillStyle = colour("--soft");
  context.font = "12px system-ui, sans-serif";
  for (let n = Math.ceil(span.from / step - 1e-9); n * step <= span.to; n++) {
    const x = ((n * step - span.from) / length) * width;
    context.fillRect(x, height - 7, 1, 7);
    const text = clockText(n * step, step < 0.1 ? 2 : step < 1 ? 1 : 0);
    if (x + context.measureText(text).width + 6 < width) context.fillText(text, x + 4, height - 8);
  }
}

/** A lane: faint as it was, strong as it is after the edits, and a line for the strength of each region. */
export function drawTrack(canvas: HTMLCanvasElement, track: Track, edits: TrackEdits, span: Span, hue: string): void {
  const surface = prepared(canvas);
  if (!surface) return;
  const { context, width, height } = surface;
  const strongest = edits.runs.reduce((most, run) => Math.max(most, run.percent), 100) / 100;
  const [length, full] = [span.to - span.from, Math.min(FULL, Math.max(track.highest * strongest, 1))];
  const frameAt = (x: number): number => track.frameAt(span.from + (x / width) * length, edits);
  const y = (value: number): number => height - MARGIN_PX - (height - 2 * MARGIN_PX) * Math.min(1, value / full);
  const original: TrackEdits = plain(edits);
  for (const [state, alpha] of [[original, 0.25], [edits, 1]] as const) {
    context.globalAlpha = alpha;
    context.fillStyle = colour(hue);
    for (let x = 0; x < width; x++) {
      const first = frameAt(x);
      const value = track.largest(first, Math.max(first + 1, frameAt(x + 1)), state);
      if (value) context.fillRect(x, y(value), 1, height - MARGIN_PX - y(value));
    }
  }
  context.globalAlpha = 1;
  drawStrengths(context, track, edits, span, width, height);
}

const plains = new WeakMap<TrackEdits, TrackEdits>();

/** The edits of a track without strengths and mute: where its frames lie, and no more. */
function plain(edits: TrackEdits): TrackEdits {
  if (!edits.isMuted && !edits.runs.length) return edits;
  let found = plains.get(edits);
  if (!found) plains.set(edits, (found = { isMuted: false, offsetMs: edits.offsetMs, runs: [] }));
  return found;
}

function drawStrengths(context: CanvasRenderingContext2D, track: Track, edits: TrackEdits, span: Span, width: number, height: number): void {
  const x = (frame: number): number => ((track.timeOf(frame, edits) - span.from) / (span.to - span.from)) * width;
  const y = (percent: number): number => height - MARGIN_PX - ((height - 2 * MARGIN_PX) * percent) / MAX_PERCENT;
  context.font = "600 12px system-ui, sans-serif";
  context.lineWidth = 2;
  for (const { first, stop, percent } of edits.runs) {
    const [left, right] = [Math.max(-2, x(first)), Math.min(width + 2, x(stop))];
    if (right < 0 || left > width) continue;
    context.strokeStyle = context.fillStyle = colour("--ink");
    context.strokeRect(left, y(percent), Math.max(1, right - left), height - MARGIN_PX - y(percent));
    const text = `${percent} %`;
    const textWidth = context.measureText(text).width;
    if (right - left < textWidth + 10) continue;
    context.fillStyle = colour("--ground");
    const top = Math.min(Math.max(y(percent) + 3, 2), height - 19);
    context.fillRect(left + 3, top, textWidth + 8, 16);
    context.fillStyle = colour("--ink");
    context.fillText(text, left + 7, top + 12.5);
  }
}

const SAMPLES = 4; // of a column of pixels that has more frames

/** The array over time: a row for each actuator. `drives` fills in those of an instant. */
export function drawArray(canvas: HTMLCanvasElement, actuators: number, span: Span, full: number, frameS: number, drives: (time: number, out: Float32Array) => void): void {
  const surface = prepared(canvas);
  if (!surface) return;
  const { context, width } = surface;
  const columns = Math.max(1, Math.round(width));
  const image = new ImageData(columns, actuators);
  const [now, highest] = [new Float32Array(actuators), new Float32Array(actuators)];
  const columnS = (span.to - span.from) / columns;
  const samples = Math.min(SAMPLES, Math.max(1, Math.ceil(columnS / frameS)));
  for (let x = 0; x < columns; x++) {
    highest.fill(0);
    for (let k = 0; k < samples; k++) {
      drives(span.from + (x + (k + 0.5) / samples) * columnS, now);
      for (let n = 0; n < actuators; n++) highest[n] = Math.max(highest[n]!, now[n]!);
    }
    for (let n = 0; n < actuators; n++) {
      const row = 3 * Math.min(FULL, Math.round((FULL * highest[n]!) / full));
      image.data.set([TABLE[row]!, TABLE[row + 1]!, TABLE[row + 2]!, 255], 4 * (n * columns + x));
    }
  }
  const buffer = document.createElement("canvas");
  [buffer.width, buffer.height] = [columns, actuators];
  buffer.getContext("2d")!.putImageData(image, 0, 0);
  context.imageSmoothingEnabled = false;
  context.drawImage(buffer, 0, 0, width, surface.height);
}

/** The actuators of one side of the array as dots. */
export function drawDots(canvas: HTMLCanvasElement, drives: Float32Array, columns: number, rows: number, full: number): void {
  const surface = prepared(canvas);
  if (!surface) return;
  const { context, width, height } = surface;
  const pitch = Math.min(width / columns, height / rows);
  const [left, top] = [(width - pitch * (columns - 1)) / 2, (height - pitch * (rows - 1)) / 2];
  for (const [n, drive] of drives.entries()) {
    const [x, y] = [left + pitch * (n % columns), top + pitch * Math.floor(n / columns)];
    const fraction = Math.min(1, drive / full);
    const row = 3 * Math.min(FULL, Math.round(FULL * fraction));
    context.beginPath();
    context.arc(x, y, pitch * 0.42, 0, 2 * Math.PI);
    context.fillStyle = colour("--dot");
    context.fill();
    context.strokeStyle = colour("--line");
    context.stroke();
    if (!drive) continue;
    context.beginPath();
    context.arc(x, y, pitch * (0.12 + 0.3 * fraction), 0, 2 * Math.PI);
    context.fillStyle = `rgb(${TABLE[row]} ${TABLE[row + 1]} ${TABLE[row + 2]})`;
    context.fill();
  }
}

/** What a screen reader says of an instant of a track. */
export function trackText(track: Track, edits: TrackEdits, time: number): string {
  const frame = track.frameAt(time, edits);
  if (frame < 0 || frame >= track.head.frames) return `${clockText(time)}, outside of ${track.name}`;
  const { strong, weak } = track.level(time, edits);
  const drive = Math.round(100 * Math.max(strong, weak));
  const strength = edits.isMuted ? "muted" : `strength ${percentAt(edits.runs, frame)} percent`;
  return `${clockText(time)}, ${strength}, drive ${drive} percent`;
}
