// The page of a tactile map: a cursor that says what is under it, zoom levels and views as on a pin display, and places that
// are found by name.
import { Fault } from "./container";
import { byId, bytesOf, onFileDrop, setPressed, setText } from "./elements";
import {
  boxOf, centreOf, clamp, columnsOf, hasPin, indexOf, isLike, metAt, middleOf, nearestPlace, pinOf, pinOfPlace, pointOf, rowsOf, symbolAt, viewAt, Views, type Met, type Pin, type Point,
} from "./map_model";
import { type PointerActs, wirePointer } from "./map_pointer";
import { readMap, type MapSymbol, type Place, type TactileMap } from "./map_record";
import { Search } from "./map_search";
import { currentLanguage, KEY_LIST, lengthText, metText, placeText, setLanguage, t, wayText, type Key, type Language } from "./map_text";
import { MapView } from "./map_view";
import { MapViewport } from "./map_viewport";
import { Voice } from "./map_voice";
import { Pads } from "./pads";

const MAX_BYTES = 2 ** 27;
const MOUSE_PX = 10; // within which a pointer meets a pin
const FINGER_PX = 18;
const RULER_PX = 90;
const MAX_LEAP_VIEWS = 4; // that are searched for the next thing
const SHIFT_PINS = 3; // by which a symbol moves from level to level

const canvas = byId<HTMLCanvasElement>("view");
const voice = new Voice();
const viewport = new MapViewport(canvas, () => {
  view.redraw();
  showRuler();
});
const view = new MapView(canvas, viewport);

interface Open {
  name: string;
  map: TactileMap;
  views: Views;
  cursor: Point;
  met: Met | null;
  /** The place that was found last, and the point of it. */
  found: { place: Place; point: Point } | null;
  isGuiding: boolean;
}

let open: Open | null = null;
let isSpeechChosen = false;

const pin = (): Pin => pinOf(open!.map, viewport.level, open!.cursor);

// -- the cursor -----------------------------------------------------------------------------------------------------------

/** What is under the cursor, or within some pins of it; views that are missing are awaited. */
async function meet(reach: number, like: MapSymbol | null = null): Promise<Met | null> {
  const { map, views } = open!;
  const { level } = viewport;
  const [at, own] = [viewOf(pin()), pin()];
  const loaded = await views.load(indexOf(level, at));
  return loaded && metAt(map, level, loaded, at, own, reach, like);
}

/** The view in which a pin is seen: the one that is shown, or the one around it. */
const viewOf = (own: Pin): Pin => (hasPin(open!.map, viewport.level, viewport.at, own) ? viewport.at : viewAt(open!.map, viewport.level, pointOf(viewport.level, own)));

/** Show and say what is under the cursor after it has moved; `before` is said first. */
async function arrive(before = "", reach = 0, isPointer = false): Promise<void> {
  const own = open!;
  const { cursor } = own;
  const met = await meet(reach);
  if (open !== own || own.cursor !== cursor) return; // it has moved on
  const isNew = !isSame(met, own.met);
  own.met = met;
  if (met && isNew) voice.touch(met.symbol.kind.name, met.symbol.role);
  showMet();
  const guided = guidance();
  const hasArrived = guided !== "" && !own.isGuiding;
  if (isPointer && !(isNew && met) && !hasArrived) return;
  const say = (report: string): void => (hasArrived ? voice.sayNow(report) : voice.announce(report)); // no later sentence takes its place
  say(sentence(before, met ? metText(met) : isPointer ? "" : t("nothing"), guided));
}

function isSame(a: Met | null, b: Met | null): boolean {
  return a && b ? isLike(a.symbol, b.symbol) && a.names.join() === b.names.join() : a === b;
}

const sentence = (...parts: string[]): string => parts.filter(Boolean).join(". ");

/** Where the place is to which the page guides; the guiding ends there. */
function guidance(): string {
  const { found, isGuiding, cursor, map } = open!;
  if (!found || !isGuiding) return "";
  const isThere = isAtPlace(found.place) || pinOf(map, viewport.level, found.point).join() === pin().join();
  if (!isThere) return `${wayText(cursor, found.point, map)}: ${found.place.name}`;
  setGuiding(false);
  return `${t("arrived")}: ${placeText(found.place)}`;
}

const isAtPlace = (place: Place): boolean => !!open!.met && open!.met.symbol.role !== "label" && open!.met.symbol.kind === place.kind && open!.met.names.length === 1 && open!.met.names[0] === place.name;

function showMet(): void {
  const { met, map, cursor, found, isGuiding } = open!;
  setText("met", met ? metText(met) : "–");
  setText("around", `${zoomText()}${aroundText()}`);
  setText("way", found && isGuiding ? `${wayText(cursor, found.point, map)}: ${found.place.name}` : "");
  view.mark({ cursor: pin(), met: met?.symbol ?? null, target: found && isGuiding ? found.point : null });
}

/** The nearest place that is not under the cursor. */
function aroundText(): string {
  const place = nearestPlace(open!.map, open!.cursor, open!.met?.names ?? []);
  return place ? `; ${[t("nearest"), way(place)].filter(Boolean).join(" ")}: ${placeText(place)}` : "";
}

const way = (place: Place): string => (open ? wayText(open.cursor, centreOf(place.box), open.map) : "");

/** Move the cursor by pins; the map follows it. */
function step(right: number, up: number): void {
  const { map } = open!;
  const [row, column] = pin();
  const next = pointOf(viewport.level, [row - up, column + right]);
  const clamped = pinOf(map, viewport.level, next);
  const isEdge = clamped[0] !== row - up || clamped[1] !== column + right;
  open!.cursor = pointOf(viewport.level, clamped);
  viewport.reveal(open!.cursor);
  void arrive(isEdge ? t("edge") : "");
}

/** Move the cursor to the next thing in a direction. */
async function leap(right: number, up: number): Promise<void> {
  const own = open!;
  const { level } = viewport;
  const [last, end] = [rowsOf(own.map, level) - 1, columnsOf(own.map, level) - 1];
  let at = pin();
  const start = await symbolOf(at);
  let hasLeft = false;
  for (let left = MAX_LEAP_VIEWS * Math.max(own.map.rows, own.map.columns); left > 0; left--) {
    const next: Pin = [at[0] - up, at[1] + right];
    if (next[0] < 0 || next[1] < 0 || next[0] > last || next[1] > end) break;
    at = next;
    const symbol = await symbolOf(at);
    hasLeft ||= symbol !== start;
    if (symbol && hasLeft) break;
  }
  if (open !== own || viewport.level !== level) return;
  const isEdge = at[0] === 0 || at[1] === 0 || at[0] === last || at[1] === end;
  own.cursor = pointOf(level, at);
  viewport.reveal(own.cursor);
  void arrive(isEdge && !(await symbolOf(at)) ? t("edge") : "");
}

async function symbolOf(at: Pin): Promise<MapSymbol | null> {
  const index = viewOf(at);
  const loaded = await open!.views.load(indexOf(viewport.level, index));
  return loaded && symbolAt(open!.map, viewport.level, loaded, index, at);
}

// -- the window -----------------------------------------------------------------------------------------------------------

/** Show the next view in a direction, with the cursor in it. */
function pan(right: number, down: number): void {
  const { map } = open!;
  const [a, b] = viewport.at;
  const [row, column] = pin();
  const { level } = viewport;
  viewport.show([clamp(a + down, 0, level.viewRows - 1), clamp(b + right, 0, level.viewColumns - 1)]);
  const [i, j] = [viewport.at[0] - a, viewport.at[1] - b];
  open!.cursor = pointOf(level, pinOf(map, level, pointOf(level, [row + i * level.panRows, column + j * level.panColumns])));
  void arrive(i || j ? "" : t("edge"));
}

/** Zoom to the next level, or beyond the last. */
async function zoom(direction: 1 | -1): Promise<void> {
  const { scales, scale } = viewport;
  const own = open!;
  const { cursor, met } = own;
  const next = direction > 0 ? scales.findIndex((value) => value < scale * 0.999) : scales.filter((value) => value > scale * 1.001).length - 1;
  if (next >= 0) viewport.goTo(next, cursor);
  else viewport.zoom(direction > 0 ? 0.5 : 2, cursor);
  snap();
  const near = met && (await meet(SHIFT_PINS, met.symbol));
  if (open !== own) return;
  if (near) own.cursor = pointOf(viewport.level, near.pin); // symbols are drawn anew at each level
  const isEnd = viewport.scale === scale;
  void arrive(isEnd ? (direction > 0 ? t("finest") : t("wholeMap")) : zoomText());
}

/** Put the cursor on the nearest pin of the level that is shown. */
function snap(): void {
  open!.cursor = pointOf(viewport.level, pin());
}

function whole(): void {
  viewport.fit();
  snap();
  void arrive(`${t("wholeMap")}, ${widthText()}`);
}

const widthText = (): string => {
  const { map } = open!;
  return map.isDrawing ? "" : `${lengthText(map.columns * viewport.level.pinStep, map)} ${t("wide")}`;
};

const zoomText = (): string => [`${t("zoom")} ${viewport.levelNumber + 1} ${t("of")} ${open!.map.levels.length}`, widthText()].filter(Boolean).join(", ");

/** Everything about the place of the cursor. */
async function describe(): Promise<void> {
  open!.met = await meet(0);
  showMet();
  voice.sayNow(sentence(open!.met ? metText(open!.met) : t("nothing"), guidance(), `${zoomText()}${aroundText()}`));
}

/** A length of the map in the corner of the window. */
function showRuler(): void {
  const map = open?.map;
  const isShown = !!map && !map.isDrawing;
  byId("ruler").hidden = !isShown;
  if (!isShown) return;
  const most = RULER_PX * viewport.scale;
  const power = 10 ** Math.floor(Math.log10(most));
  const length = [5, 2, 1].map((n) => n * power).find((n) => n <= most) ?? power;
  byId("ruler-line").style.width = `${length / viewport.scale}px`;
  setText("ruler-text", lengthText(length, map));
}

// -- places ---------------------------------------------------------------------------------------------------------------

/** Go to a place: to the first level that shows it. */
async function goTo(place: Place): Promise<void> {
  const own = open!;
  const { map, cursor } = own;
  const { point, isDrawn } = await pointOfPlace(place);
  if (open !== own) return;
  own.found = { place, point };
  setGuiding(false);
  const level = Math.min(place.firstLevel, map.levels.length - 1);
  if (viewport.levelNumber < level || !isDrawn) viewport.goTo(level, point);
  own.cursor = point;
  viewport.show(viewAt(map, viewport.level, centreOf(place.box)));
  snap();
  viewport.reveal(own.cursor);
  own.met = await meet(0);
  showMet();
  const distance = wayText(cursor, point, map);
  voice.sayNow(sentence(`${placeText(place)}${distance ? `, ${distance}` : ""}`, isDrawn ? "" : t("notDrawn")));
}

/** Where a place is drawn on the first level that shows it, or the middle of its box. */
async function pointOfPlace(place: Place): Promise<{ point: Point; isDrawn: boolean }> {
  const { map, views } = open!;
  const [number, middle] = [place.firstLevel, centreOf(place.box)];
  for (const n of [Math.max(number, viewport.levelNumber), number]) {
    const level = map.levels[n];
    if (!level) continue;
    const at = viewAt(map, level, middle);
    const loaded = await views.load(indexOf(level, at));
    const found = loaded && pinOfPlace(map, level, loaded, at, place);
    if (found) return { point: pointOf(level, found), isDrawn: true };
  }
  return { point: middle, isDrawn: false };
}

async function guideTo(place: Place): Promise<void> {
  const own = open!;
  const { point } = await pointOfPlace(place);
  if (open !== own) return;
  own.found = { place, point };
  setGuiding(true);
  showMet();
  voice.sayNow(sentence(`${t("target")} ${placeText(place)}`, guidance()));
}

function toggleGuiding(): void {
  if (!open!.found) return voice.sayNow(t("noTarget"));
  if (!open!.isGuiding) return void guideTo(open!.found.place);
  setGuiding(false);
  showMet();
  voice.sayNow(t("stopped"));
}

function setGuiding(on: boolean): void {
  open!.isGuiding = on;
  byId<HTMLButtonElement>("guide").disabled = !open!.found;
  setPressed("guide", on);
  setText("guide", t(on ? "stopGuide" : "guide"));
}

const search = new Search({ goTo: (place) => void goTo(place), guideTo: (place) => void guideTo(place), way, say: (report) => voice.announce(report), speak: (report) => voice.speak(report), leave: () => canvas.focus() });

// -- speech, sound, vibration, contrast, language --------------------------------------------------------------------------

function setSpeech(on: boolean): void {
  if (on && !voice.hasSpeech) return voice.sayNow(t("noSpeech"));
  isSpeechChosen = true;
  voice.setSpeech(on);
  setPressed("speech", on);
  voice.sayNow(`${t("speech")} ${t(on ? "on" : "off")}`);
}

async function setSound(on: boolean): Promise<void> {
  setPressed("sound", on);
  voice.sayNow(`${t("sound")} ${t(on ? "on" : "off")}`);
  await voice.setSound(on);
}

function setVibration(on: boolean): void {
  voice.setVibration(on);
  setPressed("vibration", on);
  voice.sayNow(`${t("vibration")} ${t(on ? "on" : "off")}`);
}

function setContrast(on: boolean): void {
  document.documentElement.classList.toggle("contrast", on);
  setPressed("contrast", on);
  view.redraw();
}

/** Write all texts of the page in a language. */
function translate(language: Language): void {
  setLanguage(language);
  document.documentElement.lang = language;
  for (const element of document.querySelectorAll<HTMLElement>("[data-text]")) element.textContent = t(element.dataset.text as Key);
  for (const element of document.querySelectorAll<HTMLElement>("[data-label]")) element.setAttribute("aria-label", t(element.dataset.label as Key));
  setText("guide", t(open?.isGuiding ? "stopGuide" : "guide"));
  byId("other").lang = language === "en" ? "de" : "en";
  canvas.setAttribute("aria-label", `${open ? `${open.map.title}. ` : ""}${t("map")}. ${t("hint")}`);
  const help = byId("help");
  help.replaceChildren(document.createElement("dl"));
  for (const [key, meaning] of KEY_LIST[language]) {
    for (const [tag, value] of [["dt", key], ["dd", meaning]] as const) {
      const row = document.createElement(tag);
      row.textContent = value;
      help.firstElementChild!.append(row);
    }
  }
  if (!open) return;
  search.open(open.map);
  showMet();
  showRuler();
}

function toggleHelp(close = false): void {
  const help = byId("help");
  help.hidden = close || !help.hidden;
  byId("keys").setAttribute("aria-expanded", String(!help.hidden));
  if (help.hidden) canvas.focus();
  else help.focus(); // a screen reader reads it
}

// -- keys and pointers -----------------------------------------------------------------------------------------------------

const ARROWS: Record<string, [number, number]> = { ArrowRight: [1, 0], ArrowLeft: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

/** Keys that need a map. */
const MAP_KEYS: Record<string, () => void> = {
  "+": () => void zoom(1), "=": () => void zoom(1), ">": () => void zoom(1), "-": () => void zoom(-1), "<": () => void zoom(-1), Home: whole,
  "/": () => search.focus(), f: () => search.focus(), t: () => void describe(), Enter: () => void describe(), g: toggleGuiding, j: toggleGuiding, l: () => byId("list-title").focus(),
};

const KEYS: Record<string, () => void> = {
  s: () => setSpeech(!voice.isSpoken), m: () => void setSound(!voice.isSounding), v: () => setVibration(!voice.isVibrating),
  h: () => setContrast(!document.documentElement.classList.contains("contrast")), o: () => byId("file").click(), "?": () => toggleHelp(), Escape: () => toggleHelp(true),
};

function wireKeys(): void {
  document.addEventListener("keydown", (event) => {
    const target = event.target as HTMLElement;
    const isControl = /^(BUTTON|SUMMARY)$/.test(target.tagName);
    if (target.tagName === "INPUT" || event.metaKey || event.altKey) return;
    const arrow = ARROWS[event.key];
    if (arrow && open && !isControl) {
      if (event.shiftKey) pan(arrow[0], -arrow[1]);
      else if (event.ctrlKey) void leap(...arrow);
      else step(...arrow);
      return event.preventDefault();
    }
    if (event.ctrlKey || (isControl && event.key === "Enter")) return;
    const act = KEYS[event.key] ?? KEYS[event.key.toLowerCase()] ?? (open && (MAP_KEYS[event.key] ?? MAP_KEYS[event.key.toLowerCase()]));
    if (!act) return;
    act();
    event.preventDefault();
  });
}

/** Move the cursor to a pixel of the canvas. */
function point(x: number, y: number, px: number): void {
  open!.cursor = viewport.toMap(x, y);
  snap();
  void arrive("", (px * viewport.scale) / viewport.level.pinStep, true);
}

/** Move the map so that what is under a pixel comes under another. */
function drag(from: Point, to: Point): void {
  const [x, y] = viewport.centre;
  viewport.moveTo([x - (to[0] - from[0]) * viewport.scale, y + (to[1] - from[1]) * viewport.scale]);
  snap();
  showMet();
}

const POINTER_ACTS: PointerActs = {
  explore: (at, isMouse) => point(...at, isMouse ? MOUSE_PX : FINGER_PX),
  drag,
  zoom: (factor, about) => viewport.zoom(factor, viewport.toMap(...about)),
  touch: () => {
    if (!isSpeechChosen && voice.hasSpeech) setSpeech(true); // a screen reader would have taken the touch
  },
  putDown: (at) => {
    open!.met = null; // a finger that is put down hears what is there, also if it is the same as before
    point(...at, FINGER_PX);
  },
  moved: () => void arrive(zoomText()),
  click: () => void describe(),
  wheel: (factor, about) => {
    viewport.zoom(factor, viewport.toMap(...about));
    snap();
    void arrive(zoomText());
  },
};

function wireControls(): void {
  const clicks: Record<string, () => void> = {
    in: () => void zoom(1), out: () => void zoom(-1), whole, left: () => pan(-1, 0), right: () => pan(1, 0), up: () => pan(0, -1), down: () => pan(0, 1), guide: toggleGuiding,
    open: () => byId("file").click(), keys: () => toggleHelp(), contrast: KEYS.h!, speech: KEYS.s!, sound: KEYS.m!, vibration: KEYS.v!, other: () => translate(currentLanguage() === "en" ? "de" : "en"),
  };
  for (const [id, act] of Object.entries(clicks)) byId(id).onclick = act;
  byId<HTMLInputElement>("file").onchange = (event): void => void openFile((event.target as HTMLInputElement).files?.[0]);
  onFileDrop(document.body, (file) => void openFile(file));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => view.redraw());
}

// -- start ----------------------------------------------------------------------------------------------------------------

async function openFile(file: File | undefined): Promise<void> {
  if (!file) return;
  if (file.size > MAX_BYTES) return reportFault(new Fault("too large", `it has ${file.size} bytes, more than ${MAX_BYTES}.`, null), file.name);
  await openBytes(new Uint8Array(await file.arrayBuffer()), file.name);
}

async function openBytes(data: Uint8Array<ArrayBuffer>, name: string): Promise<void> {
  document.documentElement.dataset.state = "loading";
  try {
    const map = readMap(data);
    const views = new Views(map, () => view.redraw(), (error) => reportFault(error, name));
    open = { name, map, views, cursor: middleOf(map, map.levels[0]!, [0, 0]), met: null, found: null, isGuiding: false };
    view.open(views);
    snap();
    for (const [id, isHidden] of [["fault", true], ["empty", true], ["tools", false]] as const) byId(id).hidden = isHidden;
    setText("name", map.title || name);
    document.title = `${map.title || name} – touchfield`;
    setText("attribution", map.attribution);
    setText("summary", map.isDrawing ? "" : `${lengthText(boxOf(map)[2] - boxOf(map)[0], map)} × ${lengthText(boxOf(map)[3] - boxOf(map)[1], map)}`);
    translate(/^de/.test(map.language) ? "de" : currentLanguage());
    setGuiding(false);
    open.met = await meet(0);
    showMet();
    canvas.focus();
    if (document.documentElement.dataset.state === "loading") document.documentElement.dataset.state = "ready"; // no view was damaged
  } catch (error) {
    reportFault(error, name);
  }
}

function reportFault(error: unknown, name: string): void {
  const place = error instanceof Fault && error.byte !== null ? ` (byte ${error.byte})` : "";
  setText("fault", `${name}: ${error instanceof Fault ? error.message : String(error)}${place}`);
  byId("fault").hidden = false;
  document.documentElement.dataset.state = "fault";
}

async function start(): Promise<void> {
  translate(/^de/.test(navigator.language) ? "de" : "en");
  wireControls();
  wirePointer(canvas, () => open !== null, POINTER_ACTS);
  wireKeys();
  new Pads(movePad, (key) => document.body.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true })));
  document.documentElement.dataset.state = "empty";
  const medium = byId("given-medium");
  if (medium.textContent!.trim()) await openBytes(bytesOf("given-medium"), medium.dataset.name ?? "map.touch");
  else byId("empty").hidden = false;
}

/** The stick of a pad: parts of a view that are not yet a pin add up. */
const rest: Point = [0, 0];

function movePad(right: number, up: number): void {
  if (!open) return;
  rest[0] += right * open.map.columns;
  rest[1] += up * open.map.columns;
  const [i, j] = rest.map(Math.trunc) as Point;
  if (!i && !j) return;
  rest[0] -= i;
  rest[1] -= j;
  step(i, j);
}

/** For tests, and for a page that has this one in a frame. */
Object.assign(window, {
  touchfield: {
    open: (data: ArrayLike<number>, name: string) => openBytes(Uint8Array.from(data), name),
    state: () => ({
      state: document.documentElement.dataset.state, cursor: open?.cursor, level: open && viewport.levelNumber, view: open && viewport.at, scale: open && viewport.scale, centre: open && viewport.centre,
      met: open?.met && { names: open.met.names, kind: open.met.symbol.kind.name, role: open.met.symbol.role }, sentences: voice.sentences,
      isGuiding: open?.isGuiding, pixel: open && viewport.toPixel(open.cursor),
    }),
  },
});

start().catch((error: unknown) => reportFault(error, "The page"));
