// The page of a movie's touch: plays movie and touch on one clock, on game pads, phones and a map of the actuators, and edits
// the strength of regions, mute and offset of each track.
import { byId, element, input, onFileDrop, setPressed, setText, takeBytes } from "./elements";
import { say } from "./speech";
import { type Edits, editList, editsOf, History, MAX_OFFSET_MS, MAX_PERCENT, namesOf, NO_EDITS, strengthsOf, type TrackEdits, withStrength } from "./timeline_edits";
import { clockText, drawArray, drawDots, drawRuler, drawTrack, type Span, trackText } from "./timeline_lanes";
import { type Entry, entriesOf, showEntries } from "./timeline_list";
import { Output } from "./timeline_output";
import { Player } from "./timeline_player";
import { arrayLane, fractionAt, laneOf, type StripActs } from "./timeline_strips";
import { FULL, type Level, type Track, tracksOf, type TrackValues } from "./timeline_track";

interface Given {
  movie: string;
  device: string;
  columns: number;
  rows: number;
  notes: string[];
  tracks: TrackValues[];
}

const MIN_SPAN_S = 0.05;
const STEP_S = 0.04;
const JUMP_S = 1;
const PERCENT_STEP = 10;
const DROP_MS = 100;
const CODEC_MISSING = "This browser does not show the picture of this movie: it lacks the codec";
const CODEC_HINT = "With a picture in H.264 (ffmpeg -i MOVIE -c:v libx264 -c:a copy OUT.mp4, then watch or mux again) every browser shows it.";

let given: Given;
let tracks: Track[] = [];
let history: History;
/** Edits while a slider moves; null: those of the history. */
let draft: Edits | null = null;
let selection: Span | null = null;
/** The fixed end of a selection by keys. */
let anchor = 0;
let target = -1; // all tracks
let span: Span = { from: 0, to: 1 };
let isWhole = true;
let strips: HTMLElement[] = [];
let drives = new Float32Array(0);
let fullDrive = 1;

const edits = (): Edits => draft ?? history.now;
const player = new Player(byId<HTMLVideoElement>("video"), () => tracks.reduce((end, track, n) => Math.max(end, track.endS(edits()[n]!)), 0));
const output = new Output(() => levelAt(player.time + input("ahead").valueAsNumber / 1000 || player.time));

function levelAt(time: number): Level {
  const out = { strong: 0, weak: 0, side: 0 };
  for (const [n, track] of tracks.entries()) {
    const level = track.level(time, edits()[n]!);
    if (Math.max(level.strong, level.weak) > Math.max(out.strong, out.weak)) out.side = level.side;
    out.strong = Math.max(out.strong, level.strong);
    out.weak = Math.max(out.weak, level.weak);
  }
  return out;
}

function drivesAt(time: number, out: Float32Array): void {
  out.fill(0);
  for (const [n, track] of tracks.entries()) track.addDrives(time, edits()[n]!, out);
}

// -- drawing --------------------------------------------------------------------------------------------------------------

let isDrawingDue = false;

/** Draw lanes and ruler before the next picture. */
function redraw(): void {
  if (isDrawingDue) return;
  isDrawingDue = true;
  requestAnimationFrame(drawLanes);
}

function drawLanes(): void {
  isDrawingDue = false;
  if (isWhole) span = { from: 0, to: player.duration };
  drawRuler(byId<HTMLCanvasElement>("ruler"), span);
  for (const [n, track] of tracks.entries()) drawTrack(canvasOf(n), track, edits()[n]!, span, `--lane-${n % 4}`);
  const frameS = 1 / Math.max(...tracks.map((track) => track.head.rate_hz));
  drawArray(canvasOf(tracks.length), drives.length, span, fullDrive, frameS, drivesAt);
  const scroll = input("scroll");
  const length = span.to - span.from;
  byId("scrolling").hidden = isWhole;
  scroll.max = String(Math.max(0, player.duration - length));
  scroll.value = String(span.from);
  scroll.setAttribute("aria-valuetext", `${clockText(span.from)} to ${clockText(span.to)}`);
  showSelection();
  showNow();
}

const canvasOf = (n: number): HTMLCanvasElement => strips[n]!.querySelector("canvas")!;
const fraction = (time: number): number => (time - span.from) / (span.to - span.from);

/** What changes with the time: playhead, clock, dots and meters. */
function showNow(): void {
  const time = player.time;
  const timeline = byId("timeline");
  timeline.style.setProperty("--at", String(fraction(time)));
  setText("clock", `${clockText(time)} / ${clockText(player.duration)}`);
  drivesAt(time, drives);
  drawDots(byId<HTMLCanvasElement>("dots"), drives, given.columns, given.rows, fullDrive);
  const level = levelAt(time);
  byId<HTMLMeterElement>("strong").value = Math.min(1, output.gain * level.strong);
  byId<HTMLMeterElement>("weak").value = Math.min(1, output.gain * level.weak);
  if (!player.isPlaying) describeNow(time);
}

/** Texts of the present instant for a screen reader; while the movie plays they would never end. */
function describeNow(time: number): void {
  for (const [n, strip] of strips.entries()) {
    strip.setAttribute("aria-valuemax", player.duration.toFixed(2));
    strip.setAttribute("aria-valuenow", time.toFixed(2));
    strip.setAttribute("aria-valuetext", n < tracks.length ? trackText(tracks[n]!, edits()[n]!, time) : `${clockText(time)}, ${arrayText()}`);
  }
  byId("dots").setAttribute("aria-label", `${given.device}: ${arrayText()}`);
}

function arrayText(): string {
  const strongest = drives.indexOf(drives.reduce((a, b) => Math.max(a, b), 0));
  const drive = Math.round(100 * (drives[strongest] ?? 0));
  if (!drive) return "no actuator is driven";
  return `strongest actuator in row ${Math.floor(strongest / given.columns) + 1}, column ${(strongest % given.columns) + 1}, ${drive} percent`;
}

let isFollowing = false;

function startFollowing(): void {
  if (!isFollowing) requestAnimationFrame(follow);
  isFollowing = true;
}

function follow(): void {
  player.checkEnd();
  const time = player.time;
  if (!isWhole && (time > span.to || time < span.from)) look(time, time + span.to - span.from);
  showNow();
  isFollowing = player.isPlaying;
  if (isFollowing) requestAnimationFrame(follow);
}

function showPlaying(): void {
  const button = byId("play");
  button.textContent = player.isPlaying ? "Pause" : "Play";
  button.setAttribute("aria-pressed", String(player.isPlaying));
  if (player.isPlaying) {
    output.start();
    startFollowing();
  } else output.stop();
  redraw();
}

// -- zoom -----------------------------------------------------------------------------------------------------------------

/** Show a span of the movie. */
function look(from: number, to: number): void {
  const length = Math.min(Math.max(to - from, MIN_SPAN_S), player.duration);
  const start = Math.min(Math.max(from, 0), player.duration - length);
  span = { from: start, to: start + length };
  isWhole = length >= player.duration;
  redraw();
}

function zoom(factor: number, about = player.time): void {
  const centre = about >= span.from && about <= span.to ? about : (span.from + span.to) / 2;
  look(centre - (centre - span.from) * factor, centre + (span.to - centre) * factor);
}

function zoomToSelection(): void {
  if (!selection) return say("Nothing is selected.");
  const margin = 0.1 * (selection.to - selection.from);
  look(selection.from - margin, selection.to + margin);
}

// -- selection ------------------------------------------------------------------------------------------------------------

function select(from: number, to: number): void {
  const end = player.duration;
  const [a, b] = [Math.min(Math.max(Math.min(from, to), 0), end), Math.min(Math.max(from, to), end)];
  selection = b > a ? { from: a, to: b } : null;
  showSelection();
}

function clearSelection(): void {
  selection = null;
  showSelection();
}

function setTarget(n: number): void {
  target = n;
  byId<HTMLSelectElement>("track").value = String(n);
  showSelection();
}

function showSelection(): void {
  const timeline = byId("timeline");
  timeline.classList.toggle("has-selection", selection !== null);
  if (selection) {
    timeline.style.setProperty("--from", String(fraction(selection.from)));
    timeline.style.setProperty("--to", String(fraction(selection.to)));
  }
  for (const [id, time] of [["from", selection?.from], ["to", selection?.to]] as const)
    if (document.activeElement !== input(id)) input(id).value = time === undefined ? "" : time.toFixed(2);
  for (const [n, strip] of strips.entries()) strip.querySelector<HTMLElement>(".selected")!.hidden = target >= 0 && n !== target && n < tracks.length;
  if (!draft) {
    const percent = percentOfSelection();
    input("percent").value = String(percent ?? 100);
    setText("percent-value", percent === null ? "mixed" : `${percent} %`);
  }
}

const targets = (): number[] => (target < 0 ? [...tracks.keys()] : [target]);

/** Frames of a track that an edit changes; null: none. */
function selectedFrames(n: number): [number, number] | null {
  const track = tracks[n]!;
  return selection ? track.framesOf(selection.from, selection.to, edits()[n]!) : [0, track.head.frames];
}

/** The strength of all selected frames; null if they have several. */
function percentOfSelection(): number | null {
  const found = new Set<number>();
  for (const n of targets()) {
    const frames = selectedFrames(n);
    if (frames) for (const percent of strengthsOf(edits()[n]!.runs, ...frames)) found.add(percent);
  }
  return found.size > 1 ? null : ([...found][0] ?? 100);
}

function selectionText(): string {
  const name = target < 0 ? "all tracks" : tracks[target]!.name;
  return selection ? `${name}, ${clockText(selection.from)} to ${clockText(selection.to)}` : `the whole of ${name}`;
}

// -- edits ----------------------------------------------------------------------------------------------------------------

const changed = (n: number, change: Partial<TrackEdits>, from = edits()): Edits => from.map((own, k) => (k === n ? { ...own, ...change } : own));

/** The edits with a strength for what is selected. */
function strengthened(percent: number): Edits {
  let out = history.now;
  for (const n of targets()) {
    const frames = selectedFrames(n);
    if (frames) out = changed(n, { runs: withStrength(out[n]!.runs, ...frames, percent) }, out);
  }
  return out;
}

function setStrength(percent: number): void {
  const bounded = Math.min(Math.max(percent, 0), MAX_PERCENT);
  if (selection && targets().every((n) => !selectedFrames(n))) return say("The selection has no touch of this track.");
  commit(strengthened(bounded), `${selectionText()}: strength ${bounded} percent`);
}

function commit(next: Edits, text: string): void {
  draft = null;
  history.push(next);
  showEdits();
  say(text);
}

function showEdits(): void {
  for (const [n, strip] of strips.entries()) {
    const own = edits()[n];
    if (!own) continue;
    strip.parentElement!.classList.toggle("is-muted", own.isMuted);
    input(`mute-${n}`).setAttribute("aria-pressed", String(own.isMuted));
    input(`offset-${n}`).value = String(own.offsetMs);
  }
  byId<HTMLButtonElement>("undo").disabled = !history.canUndo;
  byId<HTMLButtonElement>("redo").disabled = !history.canRedo;
  const entries = entriesOf(tracks, edits());
  byId("no-edits").hidden = entries.length > 0;
  const more = showEntries(byId<HTMLTableElement>("edits"), tracks, entries, goTo, removeEntry);
  setText("saved", more ? `${more} more edits are not listed.` : "");
  redraw();
}

function goTo(entry: Entry): void {
  setTarget(entry.track);
  if (entry.kind === "run") select(entry.from, entry.to);
  player.seek(entry.from);
  if (entry.from < span.from || entry.to > span.to) zoomToSelection();
  redraw();
  strips[entry.track]!.focus();
}

function removeEntry(entry: Entry): void {
  const own = edits()[entry.track]!;
  const change = { run: { runs: own.runs.filter((_, n) => n !== entry.run) }, mute: { isMuted: false }, offset: { offsetMs: 0 } }[entry.kind];
  commit(changed(entry.track, change), `Removed: ${tracks[entry.track]!.name}, ${entry.text}`);
  byId("undo").focus();
}

function toggleMute(n: number): void {
  const isMuted = !edits()[n]!.isMuted;
  commit(changed(n, { isMuted }), `${tracks[n]!.name} ${isMuted ? "muted" : "not muted"}`);
}

function setOffset(n: number): void {
  const value = Math.round(input(`offset-${n}`).valueAsNumber);
  const own = edits()[n]!.offsetMs;
  const offsetMs = Number.isFinite(value) ? Math.min(Math.max(value, -MAX_OFFSET_MS), MAX_OFFSET_MS) : own;
  input(`offset-${n}`).value = String(offsetMs);
  if (offsetMs !== own) commit(changed(n, { offsetMs }), `${tracks[n]!.name}: ${offsetMs} milliseconds`);
}

function undo(by: -1 | 1): void {
  if (by < 0 ? !history.canUndo : !history.canRedo) return say(by < 0 ? "Nothing to undo." : "Nothing to redo.");
  draft = null;
  history.step(by);
  showEdits();
  say(by < 0 ? "Undone." : "Redone.");
}

// -- files ----------------------------------------------------------------------------------------------------------------

function save(): void {
  const { name, command } = namesOf(given.movie);
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([editList(given.movie, tracks.map(({ head }) => head), edits())], { type: "application/json" }));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60000);
  history.markSaved();
  const saved = `Saved ${name}. This command writes the movie with its edits:`;
  setText("saved", saved);
  setText("command", command);
  byId("command").hidden = false;
  say(saved);
}

async function openEdits(file: File): Promise<void> {
  try {
    commit(editsOf(await file.text(), tracks.map(({ head }) => head)), `Opened ${file.name}`);
    history.markSaved();
    setText("saved", `Opened ${file.name}.`);
    report("");
  } catch (error) {
    report(`${file.name} cannot be opened: ${(error as Error).message}. Save an edit list on the page of this movie.`);
  }
}

function report(fault: string): void {
  setText("fault", fault);
  byId("fault").hidden = !fault;
}

// -- keys and pointer -----------------------------------------------------------------------------------------------------

const HELP: [string, string][] = [
  ["Space", "play or pause"],
  ["← →", "a step of 40 ms, in a lane"],
  ["Page ↑ ↓", "a second"],
  ["Home End", "start, end of the movie"],
  ["Shift + ← →", "select"],
  ["[ ]", "selection starts, ends here"],
  ["Ctrl + A, Esc", "select all, nothing"],
  ["↑ ↓", "strength of the selection, 10 %"],
  ["0, 1", "mute the selection, 100 %"],
  ["M", "mute the track"],
  ["Ctrl + Z, Y", "undo, redo"],
  ["Ctrl + S, O", "save, open edits"],
  [", . F Z", "zoom out, in, whole, selection"],
  ["T", "speak what is here"],
  ["V, S", "vibration, sound"],
  ["?", "these keys"],
];

/** Move the player; with Shift the selection reaches from where it started to there. */
function move(to: number, isSelecting: boolean): void {
  const time = player.time;
  const end = Math.min(Math.max(to, 0), player.duration);
  if (isSelecting) {
    if (!selection || (Math.abs(time - selection.from) > 1e-3 && Math.abs(time - selection.to) > 1e-3)) anchor = time;
    select(anchor, end);
  }
  player.seek(end);
  if (end < span.from || end > span.to) look(end - (span.to - span.from) / 2, end + (span.to - span.from) / 2);
  redraw();
}

const nudge = (by: number): void => setStrength((percentOfSelection() ?? 100) + by);

/** Keys in a lane, which a screen reader passes on as those of a slider. */
const LANE_KEYS: Record<string, (isShift: boolean) => void> = {
  ArrowRight: (isShift) => move(player.time + STEP_S, isShift),
  ArrowLeft: (isShift) => move(player.time - STEP_S, isShift),
  PageDown: (isShift) => move(player.time + JUMP_S, isShift),
  PageUp: (isShift) => move(player.time - JUMP_S, isShift),
  Home: (isShift) => move(0, isShift),
  End: (isShift) => move(player.duration, isShift),
  ArrowUp: () => nudge(PERCENT_STEP),
  ArrowDown: () => nudge(-PERCENT_STEP),
};

const KEYS: Record<string, () => void> = {
  " ": () => togglePlay(),
  "[": () => startSelection(),
  "]": () => endSelection(),
  "0": () => setStrength(0),
  "1": () => setStrength(100),
  m: () => (target < 0 ? say("Choose a track first.") : toggleMute(target)),
  ",": () => zoom(2),
  ".": () => zoom(0.5),
  f: () => look(0, player.duration),
  z: zoomToSelection,
  t: () => say(`${selectionText()}. ${tracks.map((track, n) => `${track.name}: ${trackText(track, edits()[n]!, player.time)}`).join(". ")}. ${arrayText()}`),
  v: () => toggleVibration(),
  s: () => toggleSound(),
  "?": () => toggleHelp(),
  Escape: () => (byId("help").hidden ? clearSelection() : toggleHelp()),
};

const WITH_CONTROL: Record<string, () => void> = {
  z: () => undo(-1),
  y: () => undo(1),
  Z: () => undo(1),
  s: save,
  o: () => input("file").click(),
  a: () => select(0, player.duration),
};

function startSelection(): void {
  select(player.time, selection && selection.to > player.time ? selection.to : player.duration);
  say(selectionText());
}

function endSelection(): void {
  select(selection && selection.from < player.time ? selection.from : 0, player.time);
  say(selectionText());
}

function wireKeys(): void {
  document.addEventListener("keydown", (event) => {
    const focused = event.target as HTMLElement;
    const isField = /^(INPUT|SELECT)$/.test(focused.tagName);
    let act: (() => void) | undefined;
    if (event.ctrlKey || event.metaKey) act = isField && event.key === "a" ? undefined : WITH_CONTROL[event.key];
    else if (event.altKey) return;
    else if (focused.classList.contains("strip") && LANE_KEYS[event.key]) act = (): void => LANE_KEYS[event.key]!(event.shiftKey);
    else if (isField || (/^(BUTTON|SUMMARY)$/.test(focused.tagName) && event.key === " ")) return;
    else act = KEYS[event.key] ?? KEYS[event.key.toLowerCase()];
    if (!act) return;
    event.preventDefault();
    act();
  });
}

/** What a pointer does in a strip: drag to select, click to go there, the wheel with keys to zoom and scroll. */
const STRIP_ACTS: StripActs = {
  timeOf: (fraction) => span.from + fraction * (span.to - span.from),
  target: (n) => setTarget(n < tracks.length ? n : -1),
  select,
  endSelect: () => say(selectionText()),
  go: (time) => {
    clearSelection();
    player.seek(time);
    redraw();
  },
  zoom,
  scroll: (fraction) => look(span.from + fraction * (span.to - span.from), span.to + fraction * (span.to - span.from)),
};

function wireRuler(): void {
  const strip = byId("ruler-strip");
  const go = (event: PointerEvent): void => {
    player.seek(STRIP_ACTS.timeOf(fractionAt(event, strip)));
    redraw();
  };
  strip.onpointerdown = (event): void => {
    strip.setPointerCapture(event.pointerId);
    go(event);
  };
  strip.onpointermove = (event): void => void (strip.hasPointerCapture(event.pointerId) && go(event));
}

// -- controls -------------------------------------------------------------------------------------------------------------

const togglePlay = (): void => (player.isPlaying ? player.pause() : player.play());

function toggleVibration(): void {
  output.isOn = !output.isOn;
  setPressed("rumble", output.isOn);
  say(output.isOn ? "Vibration on" : "Vibration off");
}

function toggleSound(): void {
  const movie = byId<HTMLVideoElement>("video");
  movie.muted = !movie.muted;
  setPressed("sound", !movie.muted);
  say(movie.muted ? "Sound off" : "Sound on");
}

function toggleHelp(): void {
  const help = byId("help");
  help.hidden = !help.hidden;
  byId("keys").setAttribute("aria-expanded", String(!help.hidden));
  redraw();
}

function showPads(): void {
  const pads = [...(navigator.getGamepads?.() ?? [])].filter((pad) => pad?.vibrationActuator);
  const parts = [pads.length ? `Game pad: ${pads.map((pad) => pad!.id.slice(0, 40)).join(", ")}.` : "Press a button of a game pad to use it."];
  if ("vibrate" in navigator && matchMedia("(pointer: coarse)").matches) parts.push("The phone vibrates, too.");
  setText("pads", parts.join(" "));
}

function wireControls(): void {
  const act: Record<string, () => void> = {
    play: togglePlay, undo: () => undo(-1), redo: () => undo(1), save, open: () => input("file").click(), keys: toggleHelp,
    rumble: toggleVibration, sound: toggleSound, "zoom-in": () => zoom(0.5), "zoom-out": () => zoom(2), "zoom-fit": () => look(0, player.duration),
    "zoom-selection": zoomToSelection, all: () => select(0, player.duration), none: clearSelection, silence: () => setStrength(0), reset: () => setStrength(100),
  };
  for (const [id, run] of Object.entries(act)) byId(id).onclick = run;
  byId("video").onclick = togglePlay;
  byId("selection").onsubmit = (event): void => event.preventDefault();
  byId("speed").onchange = (): void => player.setPace(Number(byId<HTMLSelectElement>("speed").value));
  byId("track").onchange = (): void => setTarget(Number(byId<HTMLSelectElement>("track").value));
  for (const id of ["from", "to"] as const) input(id).onchange = (): void => selectTyped(id);
  input("scroll").oninput = (): void => look(input("scroll").valueAsNumber, input("scroll").valueAsNumber + span.to - span.from);
  input("gain").oninput = (): void => {
    output.gain = input("gain").valueAsNumber / 100;
    setText("gain-value", `${input("gain").value} %`);
  };
  input("percent").oninput = (): void => {
    draft = strengthened(input("percent").valueAsNumber);
    setText("percent-value", `${input("percent").value} %`);
    redraw();
  };
  input("percent").onchange = (): void => setStrength(input("percent").valueAsNumber);
  // a slider that is moved and moved back changes nothing, and reports no change
  for (const name of ["pointerup", "blur"]) input("percent").addEventListener(name, () => setTimeout(dropDraft, DROP_MS));
  input("file").onchange = (): void => {
    const file = input("file").files?.[0];
    input("file").value = "";
    if (file) void openEdits(file);
  };
}

function dropDraft(): void {
  if (!draft) return;
  draft = null;
  showEdits();
}

/** Select from typed seconds; an end beyond the other one moves that with it. */
function selectTyped(id: keyof Span): void {
  const typed = input(id).valueAsNumber;
  if (!Number.isFinite(typed)) return showSelection();
  const length = selection ? selection.to - selection.from : JUMP_S;
  const before = selection ?? { from: 0, to: player.duration };
  if (id === "from") select(typed, before.to > typed ? before.to : typed + length);
  else select(before.from < typed ? before.from : typed - length, typed);
}

function wireWindow(): void {
  addEventListener("resize", redraw);
  new ResizeObserver(redraw).observe(byId("timeline"));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  for (const name of ["gamepadconnected", "gamepaddisconnected"]) addEventListener(name, showPads);
  addEventListener("beforeunload", (event) => void (history.isSaved || event.preventDefault()));
  onFileDrop(document.documentElement, (file) => void openEdits(file));
}

// -- start ----------------------------------------------------------------------------------------------------------------

function makeLanes(): void {
  const lanes = byId("lanes");
  for (const [n, track] of tracks.entries()) lanes.append(laneOf(track, n, { toggleMute, setOffset }, STRIP_ACTS));
  lanes.append(arrayLane(given.columns, given.rows, tracks.length, STRIP_ACTS));
  strips = [...lanes.querySelectorAll<HTMLElement>(".strip")];
  const choice = byId<HTMLSelectElement>("track");
  choice.add(new Option("All tracks", "-1"));
  for (const [n, { name }] of tracks.entries()) choice.add(new Option(name, String(n)));
}

function openMovie(): void {
  const { type } = byId("given-movie").dataset;
  const pictureless = byId("pictureless");
  if (!type) return void (pictureless.hidden = false);
  const hidePicture = (instead: string, reason: string): void => {
    setText("pictureless", instead);
    pictureless.hidden = false;
    byId("video").hidden = true;
    notice([reason]);
  };
  player.open(
    takeBytes("given-movie"), type,
    (why) => hidePicture("No picture: the touch plays alone.", `${CODEC_MISSING} (${why}). Its touch plays alone. ${CODEC_HINT}`),
    () => hidePicture("No picture: sound and touch play.", `${CODEC_MISSING}, or it has none. Sound and touch play. ${CODEC_HINT}`),
  );
}

function notice(texts: string[]): void {
  if (!texts.length) return;
  setText("notice", [byId("notice").textContent, ...texts].filter(Boolean).join(" "));
  byId("notice").hidden = false;
}

function describe(): void {
  setText("name", given.movie);
  document.title = `${given.movie}: touch of a movie`;
  setText("array-name", given.device);
  const list = element("dl", {});
  for (const [key, text] of HELP) list.append(element("div", {}, {}, element("dt", { textContent: key }), element("dd", { textContent: text })));
  byId("help").append(list);
  notice(given.notes);
}

async function start(): Promise<void> {
  given = JSON.parse(byId("given-timeline").textContent!) as Given;
  const packed = new Blob([takeBytes("given-drives")]).stream().pipeThrough(new DecompressionStream("gzip"));
  drives = new Float32Array(given.columns * given.rows);
  tracks = tracksOf(given.tracks, given.columns, drives.length, new Uint8Array(await new Response(packed).arrayBuffer()));
  fullDrive = Math.max(1, ...tracks.map(({ highest }) => highest)) / FULL;
  history = new History(tracks.map(() => NO_EDITS));
  describe();
  makeLanes();
  wireControls();
  wireKeys();
  wireRuler();
  wireWindow();
  player.onchange = showPlaying;
  openMovie();
  showPads();
  setTarget(-1);
  showEdits();
  setText("summary", `${tracks.length} ${tracks.length > 1 ? "tracks" : "track"} of touch, ${clockText(player.duration)}`);
  document.documentElement.dataset.state = "ready";
}

/** For tests: what the page shows. */
Object.assign(window, {
  touchfield: {
    state: () => ({
      state: document.documentElement.dataset.state, time: player.time, duration: player.duration, playing: player.isPlaying, edits: edits(), selection, target, span,
      level: levelAt(player.time), drives: [...drives], isSaved: history.isSaved,
    }),
    levelAt,
  },
});

start().catch((error: unknown) => {
  report(`The page cannot show this movie: ${(error as Error).message ?? String(error)}.`);
  document.documentElement.dataset.state = "fault";
});
