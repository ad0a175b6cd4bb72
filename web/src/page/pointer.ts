// Mouse, fingers and pen on the view: they move the probe, turn and zoom the view, and drag the slice by its handle.
import { byId } from "../elements";
import type { Met } from "../engine";
import { depthOf } from "./depth";
import { medium } from "./medium";
import { view } from "./outputs";
import * as probe from "./probe";
import * as slice from "./slice";
import { latest } from "./status";
import * as steps from "./steps";
import { decoder } from "./threads";

type Position = [number, number];

const fingers = new Map<number, Position>();
let isDraggingSlice = false;

export function wire(): void {
  const canvas = byId("view");
  canvas.addEventListener("pointerdown", (event) => medium && press(event, canvas));
  canvas.addEventListener("pointermove", (event) => medium && move(event, canvas));
  for (const end of ["pointerup", "pointercancel"] as const) canvas.addEventListener(end, release);
  canvas.addEventListener("wheel", turnWheel, { passive: false });
}

/** How deeply a pointer presses, as a multiple of the slider's depth. */
const pressureOf = (event: PointerEvent): number => (event.pointerType === "pen" ? 2 * event.pressure : 1);

/** Whether a pointer is on the handle of the slice, or close to it. */
function isOnHandle({ clientX, clientY }: PointerEvent): boolean {
  const label = document.querySelector<HTMLElement>("#labels .handle");
  if (!label || label.hidden) return false;
  const box = label.getBoundingClientRect();
  return clientX > box.left - 8 && clientX < box.right + 8 && clientY > box.top - 8 && clientY < box.bottom + 8;
}

/** Put the probe where a pointer meets the slice or the surface, else into the plane through it that faces the viewer. */
const feel = latest(async (x: number, y: number, pressure: number) => {
  const inSlice = view.pointAt(x, y);
  if (inSlice) return probe.feelAt(inSlice);
  const ray = view.ray(x, y);
  const met = await decoder.request<Met | null>({ do: "contact", time: null, rays: [ray], depth: depthOf(medium!) * pressure, away: view.away() });
  if (!met) return probe.feelAt(view.facing(ray, probe.point));
  if (medium!.isPins) return probe.feelAt(met.point);
  probe.meet(met);
});

function press(event: PointerEvent, canvas: HTMLElement): void {
  const { clientX, clientY, pointerId, pointerType } = event;
  fingers.set(pointerId, [clientX, clientY]);
  canvas.setPointerCapture(pointerId);
  isDraggingSlice = isOnHandle(event);
  if (!isDraggingSlice && pointerType !== "mouse" && fingers.size === 1) feel(clientX, clientY, pressureOf(event));
}

function move(event: PointerEvent, canvas: HTMLElement): void {
  const { clientX: x, clientY: y, pointerId, pointerType } = event;
  const before = fingers.get(pointerId);
  canvas.style.cursor = isOnHandle(event) || isDraggingSlice ? "grab" : "";
  if (!before) return void (pointerType === "mouse" && feel(x, y, 1));
  const [dx, dy] = [x - before[0], y - before[1]];
  if (isDraggingSlice) slice.moveTo(slice.position + view.dragged(dx, dy));
  else if (fingers.size > 1) view.orbit(-dx * 0.004, dy * 0.004, spread(pointerId, before, [x, y]));
  else if (pointerType === "mouse" && !view.isFlat) view.orbit(-dx * 0.007, dy * 0.007);
  else feel(x, y, pressureOf(event));
  fingers.set(pointerId, [x, y]);
}

/** By how much two fingers are farther apart, as a factor, after one of them has moved. */
function spread(moved: number, before: Position, after: Position): number {
  const other = [...fingers].find(([id]) => id !== moved)![1];
  return Math.hypot(after[0] - other[0], after[1] - other[1]) / Math.max(Math.hypot(before[0] - other[0], before[1] - other[1]), 1);
}

function release(event: PointerEvent): void {
  fingers.delete(event.pointerId);
  isDraggingSlice = false;
}

function turnWheel(event: WheelEvent): void {
  event.preventDefault();
  if (event.shiftKey) steps.deepen(-Math.sign(event.deltaY || event.deltaX));
  else view.orbit(0, 0, Math.exp(-event.deltaY * 0.001));
}
