// Controls of the view: where it is seen from, whether the surface is cut open at the slice, and its contrast.
import { byId, setPressed } from "../elements";
import { say, WITHOUT_WEBGL } from "../speech";
import { view } from "./outputs";

export function wire(): void {
  byId("contrast").onclick = toggleContrast;
  byId("open-cut").onclick = toggleCut;
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => view.recolour());
}

/** Turn the view, and say from where it is seen. */
export function turn(across: number, height: number, nearer = 1): void {
  if (view.isFlat) return say(WITHOUT_WEBGL);
  view.orbit(across, height, nearer);
  say(view.seenFrom());
}

export function turnBack(): void {
  if (view.isFlat) say(WITHOUT_WEBGL);
  else view.reset();
}

/** Cut the surface open at the slice, or close it. */
export function toggleCut(): void {
  if (view.isFlat) return say(WITHOUT_WEBGL);
  view.isOpen = !view.isOpen;
  setPressed("open-cut", view.isOpen);
  view.due();
}

export function toggleContrast(): void {
  setPressed("contrast", document.documentElement.classList.toggle("contrast"));
  view.recolour();
}
