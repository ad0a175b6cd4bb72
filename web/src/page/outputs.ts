// What the page shows and plays with: the picture of the field, the line of |F| over time, and sound.
import { byId } from "../elements";
import { FlatView } from "../flat";
import { Sound } from "../sound";
import { LOST_WEBGL, WITHOUT_WEBGL } from "../speech";
import { Trace } from "../trace";
import { View } from "../view";
import { notice } from "./status";

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

export const view = viewOf(byId<HTMLCanvasElement>("view"), byId("labels"));
export const trace = new Trace(byId<HTMLCanvasElement>("trace"));
export const sound = new Sound();
