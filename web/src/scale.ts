// The scale of what is shown in the page of a field: its bar of colours, its unit and its caption.
import { colourOf } from "./colour";
import { byId, setText } from "./elements";

/** What colours stand for: forces, heights of pins, or errors as fractions of the bound. */
type Quantity = "force" | "height" | "error";

interface Scale {
  quantity: Quantity;
  isArray: boolean;
  isFlat: boolean;
  /** What the brightest colour stands for. */
  top: number;
  /** The caption of errors. */
  difference: string;
}

const TITLE: Record<Quantity, string> = { force: "Force, newtons", height: "Height, percent", error: "Error / bound" };
const UNIT: Record<Quantity, string> = { force: "N", height: "% of the travel", error: "of the error bound" };
const TRACED: Record<Quantity, string> = { force: "2 s of |F|", height: "2 s of the height", error: "2 s of it" };

const PINS = "Each pin is as high as a finger from above meets the surface: the higher and the brighter, the higher the surface.";
const ARRAY = "Each disc or pin is an actuator: the higher and the brighter it is, the stronger it pushes.";
const SLICE = "The slice goes through the probe: its colour is the force inside, arrows point where it pushes. Orange: your probe, and the force on a hand that holds it; white: the proxy, which stays on the surface.";
const SURFACE = "Surface: where a hand first feels a force; its colour: the force once it is pressed in by the length that “Pressed in” sets. Slice: the force inside, with cones that point where it pushes. Orange: your probe, and the force on a hand that holds it; white: the proxy, which stays on the surface.";

/** Write the scale into the page. */
export function showScale(scale: Scale): void {
  const { quantity, top } = scale;
  drawBar(byId<HTMLCanvasElement>("bar"));
  byId("ticks").replaceChildren(...[4, 3, 2, 1, 0].map((n) => {
    const item = document.createElement("li");
    item.textContent = quantity === "height" ? String(25 * n) : ((top * n) / 4).toPrecision(2).replace(/^0\.0$/, "0");
    return item;
  }));
  setText("scale", TITLE[quantity]);
  setText("unit", UNIT[quantity]);
  setText("traced", TRACED[quantity]);
  setText("caption", captionOf(scale));
}

function captionOf({ quantity, isArray, isFlat, difference }: Scale): string {
  if (quantity === "error") return difference;
  if (quantity === "height") return PINS;
  if (isArray) return ARRAY;
  return isFlat ? SLICE : SURFACE;
}

function drawBar(canvas: HTMLCanvasElement): void {
  const paint = canvas.getContext("2d")!;
  for (let y = 0; y < canvas.height; y++) {
    paint.fillStyle = `rgb(${colourOf(1 - y / (canvas.height - 1)).join()})`;
    paint.fillRect(0, y, canvas.width, 1);
  }
}
