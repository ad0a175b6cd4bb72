// Pointers on the canvas of a map: one finger explores and two move and zoom; a mouse explores, and moves the map while it is
// pressed; the wheel zooms.
import type { Point } from "./map_model";

const DRAG_PX = 5;
const WHEEL = 0.0015; // logarithm of the scale, for a pixel

/** What pointers request; points are pixels of the canvas. */
export interface PointerActs {
  explore(at: Point, isMouse: boolean): void;
  /** What is under `from` comes under `to`. */
  drag(from: Point, to: Point): void;
  zoom(factor: number, about: Point): void;
  /** A finger is put down, as the first or another one. */
  touch(): void;
  putDown(at: Point): void;
  /** The map has been moved or zoomed, and the pointer is lifted. */
  moved(): void;
  click(): void;
  wheel(factor: number, about: Point): void;
}

interface Pointer {
  at: Point;
  start: Point;
}

/** Pass on what fingers and mouse request, while `isOpen` returns true. */
export function wirePointer(canvas: HTMLCanvasElement, isOpen: () => boolean, acts: PointerActs): void {
  const pointers = new Map<number, Pointer>(); // those that are down, by their number
  let isDragging = false;
  canvas.addEventListener("pointerdown", (event) => {
    if (!isOpen()) return;
    const at = pixelOf(event);
    pointers.set(event.pointerId, { at, start: at });
    canvas.setPointerCapture(event.pointerId);
    isDragging = false;
    if (event.pointerType !== "touch") return;
    acts.touch();
    if (pointers.size === 1) acts.putDown(at);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!isOpen()) return;
    const [own, at, isMouse] = [pointers.get(event.pointerId), pixelOf(event), event.pointerType === "mouse"];
    if (own && pointers.size === 2) return pinch(pointers, own, at, acts);
    if (own && isMouse) {
      isDragging ||= Math.hypot(at[0] - own.start[0], at[1] - own.start[1]) > DRAG_PX;
      if (isDragging) acts.drag(own.at, at);
    } else acts.explore(at, isMouse);
    if (own) own.at = at;
  });
  for (const kind of ["pointerup", "pointercancel"] as const) {
    canvas.addEventListener(kind, (event) => {
      const wasSeveral = pointers.size > 1;
      if (!pointers.delete(event.pointerId) || !isOpen()) return;
      if (wasSeveral || isDragging) acts.moved();
      else if (event.pointerType === "mouse") acts.click();
    });
  }
  canvas.addEventListener("wheel", (event) => {
    if (!isOpen()) return;
    event.preventDefault();
    acts.wheel(Math.exp(WHEEL * event.deltaY), pixelOf(event));
  }, { passive: false });
}

const pixelOf = (event: MouseEvent): Point => [event.offsetX, event.offsetY];

/** Two fingers zoom about their middle, and move the map with it. */
function pinch(pointers: Map<number, Pointer>, own: Pointer, at: Point, acts: PointerActs): void {
  const before = spread(pointers);
  own.at = at;
  const after = spread(pointers);
  acts.zoom(before.distance / Math.max(after.distance, 1), before.middle);
  acts.drag(before.middle, after.middle);
}

function spread(pointers: Map<number, Pointer>): { middle: Point; distance: number } {
  const [a, b] = [...pointers.values()].map(({ at }) => at) as [Point, Point];
  return { middle: [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2], distance: Math.hypot(a[0] - b[0], a[1] - b[1]) };
}
