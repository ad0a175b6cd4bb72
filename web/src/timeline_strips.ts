// The lanes of a movie's touch as elements: head, buttons, and a strip of time that keys, pointer and wheel move in.
import { element } from "./elements";
import { FULL, type Track } from "./timeline_track";

const CLICK_PX = 4;
const ZOOM_PX = 300; // of the wheel, for a factor of e

/** What a pointer requests of strip `n`; fractions are those of the strip's width, times are seconds. */
export interface StripActs {
  timeOf(fraction: number): number;
  target(n: number): void;
  select(from: number, to: number): void;
  endSelect(): void;
  go(time: number): void;
  zoom(factor: number, about: number): void;
  scroll(fraction: number): void;
}

/** What the controls of the lane of track `n` request. */
export interface LaneActs {
  toggleMute(n: number): void;
  setOffset(n: number): void;
}

/** The lane of a track. */
export function laneOf(track: Track, n: number, acts: LaneActs, stripActs: StripActs): HTMLElement {
  const { name, head, highest } = track;
  const title = element("h2", {}, {}, element("span", { className: "swatch" }, { "aria-hidden": "true" }), name, element("small", {}, {}, `peak ${Math.round((100 * highest) / FULL)} %, ${+head.rate_hz.toFixed(2)} Hz`));
  const mute = element("button", { id: `mute-${n}`, type: "button", textContent: "Mute", onclick: () => acts.toggleMute(n) }, { "aria-pressed": "false", "aria-label": `Mute ${name}` });
  const offset = element("input", { id: `offset-${n}`, type: "number", step: "1", value: "0", onchange: () => acts.setOffset(n) }, { "aria-label": `Offset of ${name}, milliseconds` });
  const label = element("label", {}, {}, "Offset ", offset, " ms");
  return element("div", { className: `lane lane-${n % 4}` }, {}, element("div", { className: "head" }, {}, title, mute, label), stripOf(name, n, stripActs));
}

/** The lane of all actuators, number `n`. */
export function arrayLane(columns: number, rows: number, n: number, stripActs: StripActs): HTMLElement {
  const title = element("h2", {}, {}, "All actuators", element("small", {}, {}, `${columns} × ${rows}`));
  return element("div", { className: "lane" }, {}, element("div", { className: "head" }, {}, title), stripOf("all tracks", n, stripActs));
}

/** A strip that the keys move in, as a slider of the time. */
function stripOf(name: string, n: number, acts: StripActs): HTMLElement {
  const attributes = { role: "slider", "aria-label": `Time in ${name}`, "aria-valuemin": "0", "aria-orientation": "horizontal" };
  const strip = element("div", { className: "strip", id: `strip-${n}`, tabIndex: 0 }, attributes,
    element("canvas", {}, { "aria-hidden": "true" }), element("div", { className: "selected" }), element("div", { className: "playhead" }));
  strip.onfocus = (): void => acts.target(n);
  wirePointer(strip, n, acts);
  wireWheel(strip, acts);
  return strip;
}

/** Where in an element, as a fraction of its width from the left, an event happens. */
export function fractionAt(event: MouseEvent, within: HTMLElement): number {
  const box = within.getBoundingClientRect();
  return (event.clientX - box.left) / box.width;
}

function wirePointer(strip: HTMLElement, n: number, acts: StripActs): void {
  const timeAt = (event: MouseEvent): number => acts.timeOf(fractionAt(event, strip));
  let start: { x: number; time: number; isDrag: boolean } | null = null;
  strip.onpointerdown = (event): void => {
    if (event.button) return;
    start = { x: event.clientX, time: timeAt(event), isDrag: false };
    strip.setPointerCapture(event.pointerId);
    acts.target(n);
  };
  strip.onpointermove = (event): void => {
    if (!start) return;
    start.isDrag ||= Math.abs(event.clientX - start.x) > CLICK_PX;
    if (start.isDrag) acts.select(start.time, timeAt(event));
  };
  strip.onpointerup = (event): void => {
    if (!start) return;
    if (start.isDrag) acts.endSelect();
    else acts.go(timeAt(event));
    start = null;
  };
  strip.onpointercancel = (): void => void (start = null);
}

function wireWheel(strip: HTMLElement, acts: StripActs): void {
  strip.addEventListener("wheel", (event) => {
    if (event.ctrlKey || event.metaKey) acts.zoom(Math.exp(event.deltaY / ZOOM_PX), acts.timeOf(fractionAt(event, strip)));
    else if (event.shiftKey || Math.abs(event.deltaX) > Math.abs(event.deltaY)) acts.scroll((event.deltaX || event.deltaY) / strip.clientWidth);
    else return;
    event.preventDefault();
  }, { passive: false });
}
