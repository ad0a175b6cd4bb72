// The slice through the field: the axis that it lies across, and where; with its buttons and slider.
import { byId, input, setText } from "../elements";
import type { Cut, Shown, Triple } from "../engine";
import { millimetres } from "../panel";
import { medium, type Medium } from "./medium";
import { view } from "./outputs";
import { latest } from "./status";
import { decoder } from "./threads";

export let axis = 1;
/** The position on that axis, metres. */
export let position = 0;

const axisButtons = (): HTMLElement[] => [...document.querySelectorAll<HTMLElement>("[data-axis]")];

export function wire(): void {
  for (const [n, button] of axisButtons().entries()) button.onclick = (): void => turnTo(n);
  byId("cut").oninput = (): void => {
    if (!medium) return;
    const [low, high] = medium.range(axis);
    moveTo(low + (Number(input("cut").value) / 1000) * (high - low));
  };
}

export function start({ directions, isArray, middle }: Medium): void {
  axis = view.isFlat ? view.firstAxis(directions) : directions.right.findIndex((n) => n !== 0);
  position = middle[axis]!;
  byId("slicing").hidden = isArray;
  showAxis();
}

/** Lay the slice across an axis, through the middle of the box. */
export function turnTo(across: number): void {
  if (!medium) return;
  axis = across;
  showAxis();
  const [low, high] = medium.range(axis);
  moveTo((low + high) / 2);
}

/** Move the slice to a position on its axis, metres. */
export function moveTo(metres: number): void {
  position = metres;
  redraw();
}

/** Move the slice through a point. */
export function moveThrough(point: Triple): void {
  if (position !== point[axis]) moveTo(point[axis]!);
}

/** Show where the decoder has laid the slice of a frame. */
export function follow({ cut }: Shown): void {
  if (cut) position = cut.at;
  showPosition();
}

const redraw = latest(async () => {
  if (medium!.isArray) return;
  const [low, high] = medium!.range(axis);
  position = Math.min(Math.max(position, low), high);
  view.cut(await decoder.request<Cut>({ do: "cut", axis, at: position }));
  showPosition();
});

function showAxis(): void {
  for (const [n, button] of axisButtons().entries()) button.setAttribute("aria-pressed", String(n === axis));
}

function showPosition(): void {
  const [low, high] = medium!.range(axis);
  input("cut").value = String((1000 * (position - low)) / (high - low));
  const text = `${"xyz"[axis]} ${millimetres(position)}`;
  setText("cut-value", text);
  byId("cut").setAttribute("aria-valuetext", text);
}
