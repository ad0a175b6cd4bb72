// How far the probe is pressed in behind the surface: the slider "Pressed in".
import { byId, input, setText } from "../elements";
import { millimetres } from "../panel";
import type { Medium } from "./medium";

/** Metres; at most a tenth of the box's shortest side. */
export const depthOf = ({ lengths }: Medium): number => (Number(input("depth").value) / 100) * 0.1 * Math.min(...lengths);

export function showDepth(medium: Medium): void {
  const text = millimetres(depthOf(medium));
  setText("depth-value", text);
  byId("depth").setAttribute("aria-valuetext", text);
}
