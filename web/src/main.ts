// Entry point of the page of `touchfield view`: opens a file, plays it, and lets a user probe its forces by
// pointer, keyboard, sound and game pad.
import { directionText, directionsOf, type Directions } from "./axes";
import { BrailleDisplay } from "./braille";
import { Fault, firstSegment, indexOffset } from "./container";
import { Decoder } from "./decoder";
import { byId, bytesOf, onFileDrop, setPressed, setText } from "./elements";
import type { Cut, Met, Opened, Piece, Recorded, Shown, Triple, What } from "./engine";
import { FlatView } from "./flat";
import { Hand } from "./hand";
import { latestOf } from "./latest";
import { differenceText, figuresOf, type Given, keyList, millimetres } from "./panel";
import { materialsOf, slidOver } from "./material";
import { Pads } from "./pads";
import { isPicture, readPicture } from "./picture";
import { reliefOf } from "./relief";
import type { Extremes, Walked } from "./relief_map";
import { message, prepareSaving, save } from "./saving";
import { showScale } from "./scale";
import { Sound } from "./sound";
import { heightText, LOST_WEBGL, placeText, say, slopeText, WITHOUT_WEBGL } from "./speech";
import { Trace } from "./trace";
import { PIN_ARRAYS, View } from "./view";

const MAX_BYTES = 1 << 29;
const SPOKEN_MS = 1200;
const SCAN_MS = 3000;
const AHEAD_S = 1;

// -- state --------------------------------------------------------------------------------------------------------------

interface State {
  name: string;
  opened: Opened;
  directions: Directions;
  time: number;
  point: Triple;
  /** The field at the probe, and what is shown of it: the force on the hand, where there is one. */
  field: Float64Array;
  force: Float64Array;
  memory: number;
  axis: number;
  cut: number;
  /** Whether the source is there, and which of both, or what lies between them, is shown. */
  hasSource: boolean;
  what: What;
}

const sound = new Sound();
const view = viewOf(byId<HTMLCanvasElement>("view"), byId("labels"));
const braille = new BrailleDisplay((report) => showBraille(report));
const trace = new Trace(byId<HTMLCanvasElement>("trace"));
let decoder: Decoder;
let hand: Hand; // from `start` on, as the decoder
let state: State | null = null;
let given: Given = null;
let playing = false;
let pace = 1;
let opening = 0;
const marks: Record<string, number> = {};

/** The view in three dimensions, or where there is no WebGL a slice in two. */
function viewOf(canvas: HTMLCanvasElement, labels: HTMLElement): View | FlatView {
  const context = canvas.getContext("webgl2", { antialias: true });
  canvas.addEventListener("webglcontextlost", () => notice(LOST_WEBGL));
  canvas.addEventListener("webglcontextrestored", () => notice(""));
  try {
    if (context) return new View(canvas, labels, context);
  } catch {
    // a driver may give a context that cannot be used: the canvas is then of no use, either
  }
  notice(WITHOUT_WEBGL);
  byId("open-cut").hidden = true;
  const flat = canvas.cloneNode() as HTMLCanvasElement;
  canvas.replaceWith(flat);
  return new FlatView(flat, labels);
}

/** What the page lacks here. */
function notice(sentence: string): void {
  setText("notice", sentence);
  byId("notice").hidden = !sentence;
}

/** What the page waits for; empty: for nothing. */
function waitFor(what: string): void {
  if (what) setText("waits", what);
  byId("loading").hidden = !what;
}

const range = (axis: number): [number, number] => {
  const { origin, spacing, shape } = state!.opened.head;
  return [origin[axis]! - spacing[axis]! / 2, origin[axis]! + spacing[axis]! * (shape[axis]! - 0.5)];
};
const seconds = (): number => (state!.opened.head.frames - 1) / state!.opened.head.rate;
const depth = (): number => (Number(byId<HTMLInputElement>("depth").value) / 100) * 0.1 * Math.min(...[0, 1, 2].map((n) => range(n)[1] - range(n)[0]));

/** The latest of several calls, whose errors are reported. */
function latest<A extends unknown[]>(run: (...args: A) => Promise<void>): (...args: A) => void {
  return latestOf(run, reportFault);
}

function reportFault(error: unknown, name = state?.name ?? "the file"): void {
  const details = error as { fault?: string; message?: string; byte?: number | null };
  const where = details.byte == null ? "" : `, at byte ${details.byte.toLocaleString("en")}`;
  const message = details.fault ? `${details.message} (${details.fault}${where})` : error instanceof Fault ? error.message : String(error);
  setText("fault", `${name} cannot be shown: ${message}.`);
  byId("fault").hidden = false;
  setText("saved", `Cannot be saved: ${name} cannot be shown.`);
  document.documentElement.dataset.state = "fault";
  playing = false;
  waitFor("");
  byId("empty").hidden = state !== null;
}

// -- opening ------------------------------------------------------------------------------------------------------------

async function openBytes(data: Uint8Array, name: string, figures: Given = null, source: Uint8Array | null = null): Promise<void> {
  await openAs(name, figures, !!source, null, async () => {
    if (data.length > MAX_BYTES) throw TOO_LARGE;
    return { opened: await decoder.request<Opened>({ do: "open", data, source }), data };
  });
}

/** Open the relief of a picture of depth, and report what was done. */
async function openPicture(data: Uint8Array<ArrayBuffer>, name: string): Promise<void> {
  let report = "";
  await openAs(name, null, false, null, async (own) => {
    const relief = reliefOf(await readPicture(data, name), name);
    if (own !== opening) return null;
    const { data: file, ...opened } = await decoder.request<Opened & { data: Uint8Array }>({ do: "relief", relief });
    report = `${relief.report}, ${(opened.ms / 1000).toFixed(1)} s.`;
    return { opened, data: file };
  });
  if (report && document.documentElement.dataset.state === "ready") message(report);
}

const TOO_LARGE = { fault: "too large", message: `the page takes files up to ${MAX_BYTES >> 20} MiB`, byte: null };

/** A file that the decoder has opened; its bytes where they are all there. */
interface OpenedFile {
  opened: Opened;
  data: Uint8Array | null;
}

async function openAs(name: string, figures: Given, hasSource: boolean, read: Read | null, open: (own: number) => Promise<OpenedFile | null>): Promise<void> {
  const own = ++opening;
  hand.close();
  marks.open = performance.now();
  document.documentElement.dataset.state = "opening";
  byId("empty").hidden = true;
  waitFor(`Decoding ${name}`);
  setPlaying(false);
  byId("fault").hidden = true;
  try {
    reading = null;
    const file = await open(own);
    if (own !== opening || !file) return;
    const { opened, data } = file;
    reading = read;
    const isArray = opened.head.type === 2;
    const directions = directionsOf(opened.records.axes, isArray);
    const middle = opened.head.origin.map((o, n) => o + 0.5 * opened.head.spacing[n]! * (opened.head.shape[n]! - 1)) as Triple;
    const axis = view.isFlat ? view.firstAxis(directions) : directions.right.findIndex((n) => n !== 0);
    state = { name, opened, directions, time: 0, point: middle, field: new Float64Array(5), force: new Float64Array(5), memory: opened.memory, axis, cut: middle[axis]!, hasSource, what: "decoded" };
    given = figures;
    setText("name", name);
    describe();
    marks.described = performance.now();
    await showNow(0, true);
    if (own !== opening) return;
    document.documentElement.dataset.state = "ready";
    waitFor("");
    startHand(data);
    prompt();
  } catch (error) {
    if (own === opening) reportFault(error, name);
  }
}

/** Say what is open, and how it is explored. */
function prompt(): void {
  window.clearTimeout(spokenLater);
  spokenAt = performance.now();
  const lengths = [0, 1, 2].map((n) => millimetres(range(n)[1] - range(n)[0])).join(" by ");
  const keys = "Arrow keys and Page Up and Down move the probe, f follows the surface, t says what is under it, question mark lists all keys.";
  say(`${state!.name} is open: ${byId("summary").textContent}, ${lengths}. ${keys}${view.isFlat ? ` ${WITHOUT_WEBGL}` : ""}`);
}

// -- a remote file, of which only what is played is read -------------------------------------------------------------

/** Bytes of a file, from a position to before another. */
type Read = (from: number, to: number) => Promise<Uint8Array>;

const MIN_READ_BYTES = 1 << 14;
let reading: Read | null = null;
const pending = new Map<number, Promise<void>>();

/** Open a file in parts: its end with the index, its start, and then the segments that are shown. */
async function openParts(size: number, name: string, read: Read): Promise<void> {
  pending.clear();
  await openAs(name, null, false, read, async (own) => {
    if (size > MAX_BYTES) throw TOO_LARGE;
    waitFor(`Fetching ${name}`);
    await decoder.request({ do: "room", size });
    const bring = async (from: number, to: number): Promise<Uint8Array> => {
      const data = await read(from, to);
      if (own === opening) await decoder.request({ do: "bring", at: from, data, segment: null });
      return data;
    };
    const tail = await bring(Math.max(0, size - MIN_READ_BYTES), size);
    const index = indexOffset(tail);
    const within = tail.length - (size - index);
    const entries = within < 0 && index > 0 ? await bring(index, size) : tail.subarray(Math.max(within, 0));
    const first = firstSegment(entries);
    if (!(first > 0 && first < size)) throw { fault: "cut short", message: "no index at its end", byte: null };
    await bring(0, first);
    return own === opening ? { opened: await decoder.request<Opened>({ do: "open-parts", first }), data: null } : null;
  });
}

/** Fetch what is shown about a time. */
async function fetched(time: number): Promise<void> {
  const [own, read] = [opening, reading];
  if (!read) return;
  for (const { segment, from, to } of await decoder.request<Piece[]>({ do: "missing", time })) {
    if (!pending.has(segment))
      pending.set(segment, read(from, to).then(async (data) => {
        if (own === opening) await decoder.request({ do: "bring", at: from, data, segment });
      }).finally(() => pending.delete(segment)));
    await pending.get(segment);
  }
}

const fetchAhead = latest(fetched);

/** Describe a file before a frame is decoded. */
function describe(): void {
  const { opened, directions, name } = state!;
  const { head, records } = opened;
  byId("legend").hidden = false;
  byId("time").hidden = head.frames < 2;
  byId("slicing").hidden = head.type === 2;
  document.title = `${name} – touchfield`;
  byId("labels").dataset.device = records.device;
  const lengths = [0, 1, 2].map((n) => range(n)[1] - range(n)[0]);
  const axes = lengths.map((m, n) => `${"xyz"[n]} ${directions.names[n]} · ${millimetres(m)}`.replace("  ", " "));
  view.start(head, directions, { box: `${head.type === 2 ? "actuators" : "workspace"} of ${records.device || "the device"}`, axes });
  const what = head.type === 2 ? `${head.shape[0]} × ${head.shape[1]} actuators` : head.objects ? `${head.objects} bodies` : "a force field";
  setText("summary", `${what}${head.frames > 1 ? ` over ${((head.frames / head.rate)).toPrecision(2)} s` : ""}, for ${records.device || "a device"}`);
  byId("fields").hidden = !state!.hasSource;
  scaleNow();
  figuresOf(byId("figures"), byId("provenance"), opened, given, isPins());
  surfaces = materialsOf(opened.records.provenance.find(([key]) => key === "materials.json")?.[1]);
  prepareSaving(head);
  jumps();
  for (const [n, button] of [...document.querySelectorAll<HTMLButtonElement>("[data-axis]")].entries())
    button.setAttribute("aria-pressed", String(n === state!.axis));
  const whole = head.frames / head.rate;
  byId<HTMLSelectElement>("speed").value = whole < 0.1 ? "0.01" : whole < 0.6 ? "0.1" : "1";
  byId<HTMLInputElement>("at").max = String(seconds());
  showDepth();
}

/** Whether the file is for pins, which have heights. */
const isPins = (): boolean => state?.opened.head.type === 2 && PIN_ARRAYS.test(state.opened.records.device);
const isError = (): boolean => state?.what === "difference";
/** What the brightest colour stands for: newtons, or in a difference the error bound. */
const top = (): number => (isError() ? 1 : state!.opened.head.peak);

/** The scale of what is shown, and the words that belong to it. */
function scaleNow(): void {
  const { opened, what } = state!;
  view.scale(top(), isError() ? 1 + Number(given?.source_share ?? 0) : Infinity);
  trace.start(top());
  showScale({
    quantity: isError() ? "error" : isPins() ? "height" : "force", isArray: opened.head.type === 2, isFlat: view.isFlat, top: top(),
    difference: differenceText(given, !!opened.head.objects),
  });
  for (const button of document.querySelectorAll<HTMLElement>("[data-what]")) button.setAttribute("aria-pressed", String(button.dataset.what === what));
}

const setWhat = latest(async (what: What) => {
  if (!state?.hasSource) return;
  state.what = what;
  await decoder.request({ do: "of", what });
  scaleNow();
  await showNow(state.time);
});

function jumps(): void {
  const buttons: [string, () => void][] = [["Strongest force", () => void jump(strongest)]];
  const worst = given?.worst_voxel as number[] | undefined;
  if (Array.isArray(worst) && worst.length === 3 && !state!.opened.head.objects) {
    const { origin, spacing, rate } = state!.opened.head;
    const position = worst.map((n, k) => origin[k]! + n * spacing[k]!) as Triple;
    buttons.push(["Largest error", () => void jump(position, Number(given!.worst_frame ?? 0) / rate)]);
  }
  byId("jumps").replaceChildren(...buttons.map(([label, act]) => {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = label;
    button.onclick = act;
    return button;
  }));
}

let strongest: Triple = [0, 0, 0];

async function jump(position: Triple, time = state!.time): Promise<void> {
  shifts = [0, 0, 0];
  if (time !== state!.time) await showNow(time);
  state!.cut = position[state!.axis]!;
  cutNow();
  await feelAt(position, false, true);
}

// -- frames -------------------------------------------------------------------------------------------------------------

async function showNow(time: number, isFirst = false): Promise<void> {
  const own = state!;
  own.time = Math.min(Math.max(time, 0), seconds());
  hand.follow(own.time, playing ? speed() : 0);
  if (reading) await fetched(own.time);
  if (own !== state) return;
  if (isFirst) {
    walked = null;
    const met = await decoder.request<Met | null>({ do: "contact", time: 0, rays: view.raysFromMiddle(), depth: depth(), away: view.away() });
    marks.felt = performance.now();
    entry = met?.entry ?? null;
    moveProbe(met?.point ?? own.point, met?.force ?? new Float64Array(5), entry);
  }
  const shown = await decoder.request<Shown>({ do: "show", time: own.time, axis: own.axis, at: isFirst && !view.isFlat ? null : own.cut, depth: depth() });
  if (own !== state) return;
  if (shown.cut) own.cut = shown.cut.at;
  own.memory = shown.memory;
  const part = shown.poses;
  if (shown.largest[0]! > 0) {
    const [x, y, z] = [shown.largest[1]!, shown.largest[2]!, shown.largest[3]!];
    strongest = [
      part[0]! * x + part[1]! * y + part[2]! * z + part[9]!, part[3]! * x + part[4]! * y + part[5]! * z + part[10]!,
      part[6]! * x + part[7]! * y + part[8]! * z + part[11]!,
    ];
  }
  view.show(shown);
  if (!("drawn" in marks) || isFirst) view.onDrawn = (): void => {
    marks.drawn = performance.now();
    view.onDrawn = null;
  };
  marks.shown = performance.now();
  byId<HTMLInputElement>("at").value = String(own.time);
  showClock();
  showCut();
  if (walks() && !playing) return walkTo(own.point);
  walked = null;
  if (!isFirst) showField(await decoder.request<Float64Array>({ do: "feel", points: own.point }));
}

function showClock(): void {
  const { rate, frames } = state!.opened.head;
  const digits = seconds() < 0.5 ? 4 : 2;
  const clock = `${state!.time.toFixed(digits)} of ${seconds().toFixed(digits)} s, frame ${Math.floor(state!.time * rate + 1e-6)} of ${frames - 1}`;
  setText("clock", clock);
  byId("at").setAttribute("aria-valuetext", clock);
}

const show = latest(async (time: number) => showNow(time));

const cutNow = latest(async () => {
  const own = state!;
  if (own.opened.head.type === 2) return;
  const [low, high] = range(own.axis);
  own.cut = Math.min(Math.max(own.cut, low), high);
  view.cut(await decoder.request<Cut>({ do: "cut", axis: own.axis, at: own.cut }));
  showCut();
});

function showDepth(): void {
  setText("depth-value", millimetres(depth()));
  byId("depth").setAttribute("aria-valuetext", millimetres(depth()));
}

function showCut(): void {
  const [low, high] = range(state!.axis);
  byId<HTMLInputElement>("cut").value = String((1000 * (state!.cut - low)) / (high - low));
  setText("cut-value", `${"xyz"[state!.axis]} ${millimetres(state!.cut)}`);
  byId("cut").setAttribute("aria-valuetext", byId("cut-value").textContent!);
}

// a movie that is shown with the touch is the clock of both
let movie: HTMLVideoElement | null = null;
let movieAt = 0;

function openMovie(): void {
  const given = byId("given-movie");
  if (!given.textContent!.trim()) return;
  movie = byId<HTMLVideoElement>("video");
  movie.src = URL.createObjectURL(new Blob([bytesOf("given-movie")], { type: given.dataset.type! }));
  movieAt = Number(given.dataset.at);
  byId("movie").hidden = false;
  movie.onclick = (): void => setPlaying(!playing);
  movie.onended = (): void => setPlaying(false);
}

const speed = (): number => Number(byId<HTMLSelectElement>("speed").value) * pace;

function setPlaying(on: boolean): void {
  playing = on;
  if (state) hand.follow(state.time, on ? speed() : 0);
  if (movie && on) {
    movie.playbackRate = Math.max(Number(byId<HTMLSelectElement>("speed").value), 0.1);
    if (movie.ended) movie.currentTime = 0;
    movie.play().catch(() => setPlaying(false));
  } else movie?.pause();
  setPressed("play", on);
  setText("play", on ? "Pause" : "Play");
  if (!on && state && walks() && document.documentElement.dataset.state === "ready") feel(state.point);
  if (!on || !state) return;
  let before = performance.now();
  const tick = async (): Promise<void> => {
    if (!playing || !state) return;
    const now = performance.now();
    const passed = (now - before) / 1000;
    before = now;
    let time = state.time + passed * speed();
    if (movie) time = Math.min(Math.max(movie.currentTime - movieAt, 0), seconds());
    else if (time > seconds()) time = 0;
    try {
      await showNow(time);
      if (reading) fetchAhead(Math.min(time + AHEAD_S * speed(), seconds()));
    } catch (error) {
      return reportFault(error);
    }
    // where a step takes longer to decode than to play, steps are kept short: it plays slower, and does not jump
    const took = (performance.now() - now) / 1000;
    pace = took > 0.25 ? Math.max(pace * 0.7, 1 / 64) : Math.min(pace * 1.1, 1);
    byId("play").title = pace < 0.9 ? `slower than requested: decoding takes longer` : "Space";
    requestAnimationFrame(() => void tick());
  };
  void tick();
}

// -- the probe ----------------------------------------------------------------------------------------------------------

let surfaces = materialsOf(undefined);
const PAUSE_S = 0.25;
let latestMove = { at: 0, speed: 0 };

/** Metres a second at which the probe moves; 0 in a pause. */
function slideSpeed(): number {
  return performance.now() / 1000 - latestMove.at < PAUSE_S ? latestMove.speed : 0;
}

function measureSpeed(metres: number): void {
  const now = performance.now() / 1000;
  const passed = now - latestMove.at;
  latestMove = { at: now, speed: passed > PAUSE_S || passed <= 0 ? 0 : metres / passed };
}

let spokenAt = 0;
let spokenLater = 0;

let entry: Triple | null = null;
/** Whether the probe is that of a device, which another program renders. */
let isFollowing = false;

/** Whether what is shown is the force on the hand, and not the bare force of the field. */
const isHand = (): boolean => hand.rendered !== null && state?.what === "decoded" && !isFollowing;

/** The probe is at a point, with this field; over a long way it is lifted, and put down at `from`, if that is given. */
function moveProbe(point: Triple, field: Float64Array, from: Triple | null = null): void {
  const far = 0.05 * Math.hypot(...[0, 1, 2].map((n) => range(n)[1] - range(n)[0]));
  const moved = Math.hypot(...point.map((v, n) => v - state!.point[n]!));
  const isJump = from !== null && moved > far;
  measureSpeed(moved);
  state!.point = point;
  hand.move(point, isJump ? from : null);
  showField(field);
  if (view.isFlat && state!.cut !== point[state!.axis]) {
    state!.cut = point[state!.axis]!;
    cutNow();
  }
}

/** The field at the probe has changed. */
function showField(field: Float64Array): void {
  state!.field = field;
  if (!isHand()) showForce();
  if (braille.isOpen) showLine();
  const wait = SPOKEN_MS - (performance.now() - spokenAt);
  window.clearTimeout(spokenLater);
  spokenLater = window.setTimeout(() => speak(), Math.max(wait, 250));
}

/** A line of the field through the probe, from the left to the right, on the Braille display. */
const showLine = latest(async () => {
  const own = state!;
  const [axis, sign] = along(own.directions.right);
  const [low, high] = range(axis);
  const points = Array.from({ length: braille.columns }, (_, n) => {
    const fraction = (n + 0.5) / braille.columns;
    return own.point.map((v, k) => (k !== axis ? v : sign > 0 ? low + fraction * (high - low) : high - fraction * (high - low)));
  });
  const { outward, right, ahead } = own.directions;
  if (walked && extremes) {
    const { lowest, highest } = isPins() ? { lowest: 0, highest: 1 } : extremes;
    const heights = await decoder.request<Float64Array>({ do: "profile", directions: { outward, right, ahead }, points: points.flat() });
    return braille.show(Array.from(heights, (height) => (Number.isNaN(height) ? 0 : (height - lowest) / (highest - lowest || 1))));
  }
  const forces = await decoder.request<Float64Array>({ do: "feel", points: points.flat() });
  return braille.show(points.map((_, n) => Math.hypot(forces[5 * n]!, forces[5 * n + 1]!, forces[5 * n + 2]!) / top()));
});

function showForce(): void {
  const own = state!;
  const rendered = isHand() ? hand.rendered : null;
  const force = (own.force = rendered ? Float64Array.of(...rendered.force, ...own.field.subarray(3)) : own.field);
  const size = Math.hypot(force[0]!, force[1]!, force[2]!);
  const vibration = isError() ? 0 : force[3]!;
  setText("size", isPins() && !isError() ? ((100 * size) / top()).toFixed(0) : size.toFixed(2));
  setText("height", walked ? `${heightText(walked, extremes, isPins())}, ${slopeText(walked, own.directions)}` : "");
  if (isError()) setText("parts", `${(1000 * size * force[3]!).toFixed(1)} of ${(1000 * force[3]!).toFixed(1)} mN`);
  else if (isPins()) setText("parts", placeText(own.point, own.opened.head, own.directions));
  else setText("parts", `x ${force[0]!.toFixed(2)}   y ${force[1]!.toFixed(2)}   z ${force[2]!.toFixed(2)} N`);
  setText("vibrates", vibration > 0 ? `vibrates ${vibration.toFixed(2)} N at ${force[4]!.toFixed(0)} Hz` : "");
  const label = isPins() && !isError() ? `${((100 * size) / top()).toFixed(0)} %` : `${size.toFixed(2)} ${isError() ? "of bound" : "N"}`;
  view.setProbe(own.point, force, label, rendered?.isInContact ? rendered.proxy : null);
  trace.add(size);
  const side = own.directions.right.reduce((sum, direction, n) => sum + direction * force[n]!, 0) / (size || 1);
  const [texture, hertz] = slidOver(surfaces, own.point, slideSpeed(), isError() ? 0 : size);
  if (texture > vibration) sound.play(size / top(), side, texture / top(), hertz);
  else sound.play(size / top(), side, vibration / top(), force[4]!);
}

// -- the hand -----------------------------------------------------------------------------------------------------------

const MAX_HAND_BYTES = 1 << 26;

/** Give the hand the file that is shown; from then on the force is the one that it renders. */
function startHand(data: Uint8Array | null, isContinued = false): void {
  if (state!.opened.head.type === 2) return hand.close("an array of actuators is not touched with a probe"), showHand();
  if (!data || data.length > MAX_HAND_BYTES) return hand.close(data ? "the file is too large" : "the file is read in parts"), showHand();
  hand.open(data, isContinued);
  hand.move(state!.point, entry ?? state!.point);
  hand.follow(state!.time, playing ? speed() : 0);
}

/** A report of the hand. */
function showHand(): void {
  if (!state) return;
  const { rendered, fault } = hand;
  const ticks = rendered?.hertz ? `${rendered.hertz} ticks a second` : "starts";
  setText("hand", fault ? `none, ${fault}: the force of the field is shown` : `${ticks}${rendered?.missed ? `, ${rendered.missed} left out` : ""}`);
  if (isHand() || fault) showForce();
}

/** A sentence for those who do not see, at most one in a while. */
function speak(isRequested = false): void {
  if (!state || (playing && !isRequested)) return;
  spokenAt = performance.now();
  const { point, force, directions, opened } = state;
  const parts = [forceText(force, directions), placeText(point, opened.head, directions)];
  if (walked) parts.unshift(`${heightText(walked, extremes, isPins())}, ${slopeText(walked, directions)}`);
  say(parts.filter(Boolean).join("; "));
}

/** The force under the probe; of pins, whose heights are spoken, nothing. */
function forceText(force: Float64Array, directions: Directions): string {
  const size = Math.hypot(force[0]!, force[1]!, force[2]!);
  if (isPins() && !isError()) return "";
  if (!(size > 0.002 * top())) return isError() ? "no difference" : "no force";
  const vibration = !isError() && force[3]! > 0 ? `, vibrates at ${force[4]!.toFixed(0)} hertz` : "";
  return `${size.toFixed(2)} ${isError() ? "of the error bound" : "newtons"}, ${directionText(force, directions)}${vibration}`;
}

// -- the surface --------------------------------------------------------------------------------------------------------

let isOnSurface = false;
/** The place of the surface that the probe is on, and the surface's lowest and highest heights; null: it is not. */
let walked: Walked | null = null;
let extremes: Extremes | null = null;
let extremesOf = "";
let isFineStep = false;

const COARSE = 0.02; // steps of keys, fractions of the box
const FINE = 0.004;
const walks = (): boolean => isOnSurface || isPins();

/** Metres of a key's step along an axis; of an array the way to the next actuator. */
function stepOf(axis: number, isFine: boolean): number {
  if (state!.opened.head.type === 2) return state!.opened.head.spacing[axis]!;
  const [low, high] = range(axis);
  return (high - low) * (isFine ? FINE : COARSE);
}

/** The actuator of an array that is nearest to a point; in a field the point itself. */
function snapped(point: Triple): Triple {
  const { type, origin, spacing, shape } = state!.opened.head;
  if (type !== 2) return point;
  return point.map((v, n) => origin[n]! + spacing[n]! * Math.min(Math.max(Math.round((v - origin[n]!) / spacing[n]!), 0), shape[n]! - 1)) as Triple;
}

/** Put the probe on the surface in front of or behind a point, with its heights. */
async function walkTo(point: Triple): Promise<void> {
  const own = state!;
  const at = snapped(point);
  const { outward, right, ahead } = own.directions;
  const shown = [opening, own.time, own.what].join();
  if (extremesOf !== shown) {
    extremesOf = shown;
    extremes = await decoder.request<Extremes | null>({ do: "extremes", directions: { outward, right, ahead } });
  }
  const steps = [right, ahead].map((direction) => stepOf(along(direction)[0], isFineStep)) as [number, number];
  const found = await decoder.request<Walked & { field: Float64Array }>({ do: "walk", walk: { outward, right, ahead, at, depth: depth(), steps } });
  if (own !== state) return;
  walked = found;
  const [axis, sign] = along(outward);
  const before = [...found.point] as Triple; // over a long way the hand is lifted, and put down in front of the surface
  before[axis] = before[axis]! + 1.5 * sign * depth();
  moveProbe(found.point, found.field, before);
}

function setOnSurface(on: boolean): void {
  isOnSurface = on;
  setPressed("follow", on);
  if (!on) walked = null;
  if (state) feel(state.point);
  say(on ? "The probe follows the surface: arrow keys move over it as over a map." : "The probe moves freely.");
}

const feelAt = async (point: Triple, isFollowed = false, isLifted = false): Promise<void> => {
  const bounded = point.map((m, n) => Math.min(Math.max(m, range(n)[0]), range(n)[1])) as Triple;
  isFollowing = isFollowed;
  if (walks() && !isFollowed) return walkTo(bounded);
  walked = null;
  moveProbe(bounded, await decoder.request<Float64Array>({ do: "feel", points: bounded }), isLifted ? bounded : null);
};
const feel = latest(feelAt);

/** Where a hand is that another program follows, and when. */
const followHand = latest(async (at: Triple, time: number) => {
  if (!state) return;
  if (Math.abs(time - state.time) > 0.5 / state.opened.head.rate) await showNow(Math.min(time, seconds()));
  await feelAt(at, true);
});

const point = latest(async (x: number, y: number, pressure: number) => {
  const inSlice = view.pointAt(x, y);
  if (inSlice) return feelAt(inSlice);
  const ray = view.ray(x, y);
  const met = await decoder.request<Met | null>({ do: "contact", time: null, rays: [ray], depth: depth() * pressure, away: view.away() });
  isFollowing = false;
  if (met && !isPins()) {
    walked = null;
    moveProbe(met.point, met.force, met.entry);
  } else if (met) await feelAt(met.point);
  else await feelAt(view.facing(ray, state!.point));
});

function wirePointer(): void {
  const canvas = byId<HTMLCanvasElement>("view");
  const fingers = new Map<number, [number, number]>();
  let slicing = false;
  const isHandle = (event: PointerEvent): boolean => {
    const label = document.querySelector<HTMLElement>("#labels .handle");
    if (!label || label.hidden) return false;
    const box = label.getBoundingClientRect();
    return event.clientX > box.left - 8 && event.clientX < box.right + 8 && event.clientY > box.top - 8 && event.clientY < box.bottom + 8;
  };
  canvas.addEventListener("pointerdown", (event) => {
    if (!state) return;
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    canvas.setPointerCapture(event.pointerId);
    slicing = isHandle(event);
    if (!slicing && event.pointerType !== "mouse" && fingers.size === 1) point(event.clientX, event.clientY, event.pointerType === "pen" ? 2 * event.pressure : 1);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!state) return;
    const before = fingers.get(event.pointerId);
    const [x, y] = [event.clientX, event.clientY];
    canvas.style.cursor = isHandle(event) || slicing ? "grab" : "";
    if (!before) return void (event.pointerType === "mouse" && point(x, y, 1));
    const [dx, dy] = [x - before[0], y - before[1]];
    if (slicing) {
      state.cut += view.dragged(dx, dy);
      cutNow();
    } else if (fingers.size > 1) {
      const other = [...fingers].find(([id]) => id !== event.pointerId)![1];
      const spread = Math.hypot(x - other[0], y - other[1]) / Math.max(Math.hypot(before[0] - other[0], before[1] - other[1]), 1);
      view.orbit(-dx * 0.004, dy * 0.004, spread);
    } else if (event.pointerType === "mouse" && !view.isFlat) view.orbit(-dx * 0.007, dy * 0.007);
    else point(x, y, event.pointerType === "pen" ? 2 * event.pressure : 1);
    fingers.set(event.pointerId, [x, y]);
  });
  for (const end of ["pointerup", "pointercancel"] as const)
    canvas.addEventListener(end, (event) => {
      fingers.delete(event.pointerId);
      slicing = false;
    });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    if (event.shiftKey) nudge("depth", -Math.sign(event.deltaY || event.deltaX) * 4);
    else view.orbit(0, 0, Math.exp(-event.deltaY * 0.001));
  }, { passive: false });
}

function nudge(id: string, by: number): void {
  const input = byId<HTMLInputElement>(id);
  input.value = String(Number(input.value) + by);
  input.dispatchEvent(new Event("input"));
}

// -- keys, buttons ------------------------------------------------------------------------------------------------------

let shifts: Triple = [0, 0, 0];

/** Move the probe by what keys and sticks have asked for since it last moved. */
const applyShifts = latest(async () => {
  const { type, spacing } = state!.opened.head;
  const by = shifts.map((metres, n) => (type === 2 ? spacing[n]! * Math.round(metres / spacing[n]!) : metres)) as Triple;
  shifts = shifts.map((metres, n) => metres - by[n]!) as Triple; // of an array what is less than a step waits
  await feelAt(state!.point.map((v, n) => v + by[n]!) as Triple);
});

/** Move the probe along one of the viewer's directions, metres. */
function shift(direction: Triple, metres: number): void {
  direction.forEach((v, n) => (shifts[n]! += v * metres));
  applyShifts();
}

/** A step of a key. On a surface seen from above, up is ahead; on one seen from the front, away is deeper. */
function step(direction: Triple, sign: number, isFine: boolean): void {
  if (!state) return;
  isFineStep = isFine;
  const { outward, ahead } = state.directions;
  const [axis, own] = along(direction);
  const isOutward = walks() && axis === along(outward)[0];
  const isFromAbove = along(state.directions.up)[0] === along(outward)[0];
  if (isOutward && !isFromAbove) return nudge("depth", own * sign === along(outward)[1] ? -4 : 4);
  shift(isOutward ? ahead : direction, sign * stepOf(isOutward ? along(ahead)[0] : axis, isFine));
}

/** The axis and sign of one of the viewer's directions. */
function along(direction: Triple): [number, number] {
  const axis = direction.findIndex((n) => n !== 0);
  return [axis, direction[axis]!];
}

/** A stick moves the probe by fractions of the box, over a surface as over a map. */
function movePad(right: number, up: number, towards: number): void {
  if (!state) return;
  isFineStep = false;
  const { directions } = state;
  const isFromAbove = walks() && along(directions.up)[0] === along(directions.outward)[0];
  for (const [direction, part] of [[directions.right, right], [isFromAbove ? directions.ahead : directions.up, up], [directions.towards, walks() ? 0 : towards]] as const)
    if (part) shift(direction, part * (range(along(direction)[0])[1] - range(along(direction)[0])[0]));
}

let scanning = 0;

/** Read a line of the field through the probe, from left to right, as sound. */
function scan(): void {
  if (!state) return;
  window.clearInterval(scanning);
  const [axis, sign] = along(state.directions.right);
  const [low, high] = range(axis);
  const back = state.point;
  const start = performance.now();
  setPressed("scan", true);
  void setSound(true);
  scanning = window.setInterval(() => {
    const fraction = (performance.now() - start) / SCAN_MS;
    const next = [...back] as Triple;
    next[axis] = sign > 0 ? low + fraction * (high - low) : high - fraction * (high - low);
    if (fraction < 1) return feel(next);
    window.clearInterval(scanning);
    setPressed("scan", false);
    feel(back);
  }, 25);
}

async function setSound(on: boolean): Promise<void> {
  setPressed("sound", on);
  await sound.sound(on);
}

function setContrast(on: boolean): void {
  document.documentElement.classList.toggle("contrast", on);
  setPressed("contrast", on);
  view.recolour();
}

/** Turn the view, and say from where it is seen. */
function turn(across: number, height: number, nearer = 1): void {
  if (view.isFlat) return say(WITHOUT_WEBGL);
  view.orbit(across, height, nearer);
  say(view.seenFrom());
}

/** A place that a key goes back to, from where it goes there again: two places are compared by hand. */
let marked: { point: Triple; time: number } | null = null;

function mark(): void {
  if (!state) return;
  marked = { point: state.point, time: state.time };
  say("This place is marked: b goes back to it.");
}

function backToMark(): void {
  if (!state) return;
  if (!marked) return say("No place is marked: n marks one.");
  const { point, time } = marked;
  marked = { point: state.point, time: state.time };
  void jump(point, time);
}

/** Put time and place into the address, which then opens the page there. */
function linkHere(): void {
  if (!state) return;
  const place = state.point.map((m) => (1000 * m).toFixed(2)).join();
  try {
    history.replaceState(null, "", `#t=${state.time.toFixed(4)}&p=${place}`);
    say("The address of the page now names this time and place.");
  } catch {
    say("The address cannot change within this frame.");
  }
}

/** The time and place that the address names. */
async function openLink(): Promise<void> {
  const link = new URLSearchParams(location.hash.slice(1));
  const place = (link.get("p") ?? "").split(",").map((mm) => Number(mm) / 1000);
  const time = Number(link.get("t") ?? 0);
  if (!state || !link.has("p") || place.length !== 3 || ![...place, time].every(Number.isFinite)) return;
  await jump(place as Triple, Math.min(Math.max(time, 0), seconds()));
}

function showBraille(report: string): void {
  setPressed("braille", braille.isOpen);
  message(report);
  if (!state) return say(report); // the status line is not shown yet
  if (braille.isOpen) feel(state.point);
}

const WHATS: What[] = ["decoded", "source", "difference"];

const ACTS: Record<string, (event: KeyboardEvent) => void> = {
  " ": () => setPlaying(!playing && !!state && state.opened.head.frames > 1),
  ",": () => state && show(state.time - 1 / state.opened.head.rate),
  ".": () => state && show(state.time + 1 / state.opened.head.rate),
  "[": () => nudge("cut", -12),
  "]": () => nudge("cut", 12),
  x: () => setAxis(0),
  y: () => setAxis(1),
  z: () => setAxis(2),
  c: () => (view.isFlat ? say(WITHOUT_WEBGL) : byId("open-cut").click()),
  "+": () => turn(0, 0, 1.15),
  "=": () => turn(0, 0, 1.15),
  "-": () => turn(0, 0, 1 / 1.15),
  a: () => turn(-0.12, 0),
  d: () => turn(0.12, 0),
  w: () => turn(0, 0.1),
  q: () => turn(0, -0.1),
  r: () => (view.isFlat ? say(WITHOUT_WEBGL) : view.reset()),
  f: () => setOnSurface(!isOnSurface),
  n: mark,
  b: backToMark,
  l: linkHere,
  Home: () => state && show(0),
  End: () => state && show(seconds()),
  "<": () => nudge("depth", -4),
  ">": () => nudge("depth", 4),
  j: () => byId("jumps").querySelector("button")?.click(),
  k: () => byId("jumps").querySelectorAll("button")[1]?.click(),
  m: () => void setSound(!sound.isOn),
  v: () => byId("rumble").click(),
  s: scan,
  e: () => setWhat(WHATS[(WHATS.indexOf(state?.what ?? "decoded") + 1) % 3]!),
  h: () => setContrast(!document.documentElement.classList.contains("contrast")),
  o: () => byId("file").click(),
  p: () => void saveFrames(false),
  t: () => state && void decoder.request({ do: "feel", points: [] }).then(() => speak(true)), // after the moves that are under way
  "?": () => toggleHelp(),
  Escape: () => toggleHelp(true),
};

function toggleHelp(close = false): void {
  const help = byId("help");
  help.hidden = close || !help.hidden;
  byId("keys").setAttribute("aria-expanded", String(!help.hidden));
}

function wireKeys(): void {
  document.addEventListener("keydown", (event) => {
    const target = event.target as HTMLElement;
    const isControl = /^(INPUT|SELECT)$/.test(target.tagName);
    const isButton = /^(BUTTON|SUMMARY)$/.test(target.tagName);
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (state && !isControl) {
      const { right, up, towards } = state.directions;
      const moves: Record<string, [Triple, number]> = {
        ArrowRight: [right, 1], ArrowLeft: [right, -1], ArrowUp: [up, 1], ArrowDown: [up, -1], PageUp: [towards, -1], PageDown: [towards, 1],
      };
      const direction = moves[event.key];
      if (direction) {
        step(...direction, event.shiftKey);
        return event.preventDefault();
      }
    }
    if ((isControl && event.key.length !== 1) || (isButton && event.key === " ") || (isControl && target.tagName === "SELECT")) return;
    const act = ACTS[event.key] ?? ACTS[event.key.toLowerCase()];
    if (!act) return;
    act(event);
    event.preventDefault();
  });
}

/** Save the frame that is shown, or a range of frames; of a file in parts all of them are fetched first. */
function saveFrames(isRange: boolean): Promise<void> {
  const isFault = document.documentElement.dataset.state === "fault";
  const source = isFault ? "the file cannot be shown, see above" : state ? { name: state.name, head: state.opened.head, time: state.time } : "no file is open";
  return save(source, isRange, async (recording) => {
    const { rate } = state!.opened.head;
    for (let n = recording.from; n < recording.from + recording.count; n++) await fetched(n / rate);
    return decoder.request<Recorded>({ do: "record", recording });
  });
}

function setAxis(axis: number): void {
  if (!state) return;
  state.axis = axis;
  const [low, high] = range(axis);
  state.cut = (low + high) / 2;
  for (const [n, button] of [...document.querySelectorAll("[data-axis]")].entries()) button.setAttribute("aria-pressed", String(n === axis));
  cutNow();
}

function wireButtons(): void {
  byId("open").onclick = (): void => byId("file").click();
  byId<HTMLInputElement>("file").onchange = async (event): Promise<void> => {
    const file = (event.target as HTMLInputElement).files?.[0];
    if (file) await openFile(file);
  };
  byId("save-frame").onclick = (): void => void saveFrames(false);
  byId("save-range").onclick = (): void => void saveFrames(true);
  byId("contrast").onclick = (): void => setContrast(!document.documentElement.classList.contains("contrast"));
  byId("keys").onclick = (): void => toggleHelp();
  byId("play").onclick = (): void => setPlaying(!playing);
  byId("sound").onclick = (): void => void setSound(!sound.isOn);
  byId("rumble").onclick = (): void => {
    sound.rumble(!sound.isRumbling);
    setPressed("rumble", sound.isRumbling);
  };
  byId("scan").onclick = scan;
  byId("follow").onclick = (): void => setOnSurface(!isOnSurface);
  byId("braille").hidden = !BrailleDisplay.isSupported;
  byId("braille").onclick = (): void => void (braille.isOpen ? braille.close() : braille.connect());
  for (const button of document.querySelectorAll<HTMLButtonElement>("[data-what]")) button.onclick = (): void => setWhat(button.dataset.what as What);
  byId("open-cut").onclick = (): void => {
    view.isOpen = !view.isOpen;
    setPressed("open-cut", view.isOpen);
    view.due();
  };
  for (const [n, button] of [...document.querySelectorAll<HTMLButtonElement>("[data-axis]")].entries()) button.onclick = (): void => setAxis(n);
}

function wireSliders(): void {
  byId<HTMLInputElement>("gain").oninput = (event): void => {
    sound.gain = Number((event.target as HTMLInputElement).value) / 100;
    setText("gain-value", `${Math.round(100 * sound.gain)} %`);
    if (state) showForce();
  };
  byId<HTMLInputElement>("cut").oninput = (event): void => {
    if (!state) return;
    const [low, high] = range(state.axis);
    state.cut = low + (Number((event.target as HTMLInputElement).value) / 1000) * (high - low);
    cutNow();
  };
  byId<HTMLInputElement>("depth").oninput = (): void => {
    if (!state) return;
    showDepth();
    show(state.time);
  };
  byId<HTMLInputElement>("at").oninput = (event): void => {
    setPlaying(false);
    if (!state) return;
    const time = Number((event.target as HTMLInputElement).value);
    if (movie) movie.currentTime = time + movieAt;
    show(time);
  };
}

function wireControls(): void {
  wireButtons();
  wireSliders();
  onFileDrop(document.body, (file) => void openFile(file));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => view.recolour());
  keyList(byId("help"));
}

/** What follows of a live medium, in place of what is open: the probe, the view and the cut stay. */
async function followBytes(data: Uint8Array, name: string): Promise<void> {
  if (!state || document.documentElement.dataset.state !== "ready") {
    await openBytes(data, name);
    byId<HTMLSelectElement>("speed").value = "1";
    return;
  }
  const own = ++opening;
  try {
    const opened = await decoder.request<Opened>({ do: "open", data, source: null });
    if (own !== opening) return;
    reading = null;
    state = { ...state, opened, name, time: 0 };
    setText("name", name);
    await showNow(0, true);
    if (own === opening) startHand(data, true);
    if (!playing) setPlaying(true);
  } catch (error) {
    reportFault(error, name);
  }
}

async function openFile(file: File): Promise<void> {
  if (file.size > MAX_BYTES) return reportFault(TOO_LARGE, file.name);
  const data = new Uint8Array(await file.arrayBuffer());
  await (isPicture(data, file.name) ? openPicture(data, file.name) : openBytes(data, file.name));
}

// -- start --------------------------------------------------------------------------------------------------------------

async function start(): Promise<void> {
  marks.start = performance.now();
  wireControls();
  wirePointer();
  wireKeys();
  new Pads(movePad, (key) => document.body.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true })));
  const packed = new Blob([bytesOf("decoder")]).stream().pipeThrough(new DecompressionStream("gzip"));
  const module = await WebAssembly.compile(await new Response(packed).arrayBuffer());
  const script = URL.createObjectURL(new Blob([byId("worker").textContent!], { type: "text/javascript" }));
  decoder = new Decoder(module, script);
  hand = new Hand(module, script, showHand);
  const medium = byId("given-medium");
  if (!medium.textContent!.trim()) {
    waitFor("");
    byId("empty").hidden = false;
  }
  document.documentElement.dataset.state = "empty";
  if (!medium.textContent!.trim()) return void (await decoder.request({ do: "warm", data: bytesOf("sample"), times: 14 }));
  openMovie();
  const figures = JSON.parse(byId("given-figures").textContent!) as Given;
  const source = byId("given-source").textContent!.trim() ? bytesOf("given-source") : null;
  await openBytes(bytesOf("given-medium"), medium.dataset.name ?? "medium.touch", figures, source);
  await openLink();
}

/** For tests, and for a page that has this one in a frame: what is open, and forces at points, newtons. */
Object.assign(window, {
  touchfield: {
    open: (data: ArrayLike<number>, name: string) => openBytes(Uint8Array.from(data), name),
    read: (size: number, name: string, read: Read) => openParts(size, name, async (from, to) => Uint8Array.from(await read(from, to))),
    follow: (data: ArrayLike<number>, name: string) => followBytes(Uint8Array.from(data), name),
    hand: (at: Triple, time: number) => followHand(at, time),
    feel: (points: number[]) => decoder.request<Float64Array>({ do: "feel", points }).then((all) => [...all]),
    seek: (time: number) => showNow(time).catch(reportFault),
    state: () => ({
      state: document.documentElement.dataset.state, name: state?.name, time: state?.time, point: state?.point, force: state && [...state.force],
      field: state && [...state.field], hand: state && hand.rendered, handFault: state && hand.fault,
      axis: state?.axis, cut: state?.cut, playing, movie: movie?.currentTime, triangles: view.triangles, cones: view.cones, bodies: view.bodies, marks, sound: sound.output,
      head: state?.opened.head, memory: state?.memory, graphicsObjects: view.graphicsObjects, what: state?.what,
    }),
  },
});

start().catch((error: unknown) => {
  reportFault(error, "The page");
  byId("empty").hidden = true;
});
