// Presents the force under the probe: as text, as a line over time, as an arrow in the view, as sound and rumble.
import { setText } from "../elements";
import type { Triple } from "../engine";
import { materialsOf, slidOver } from "../material";
import type { Medium } from "./medium";
import { sound, trace, view } from "./outputs";
import { partsText, type Reading, sizeOf, sizeText, surfaceText, vibrationOf } from "./reading";

let materials = materialsOf(undefined);

export function start({ opened }: Medium): void {
  materials = materialsOf(opened.records.provenance.find(([key]) => key === "materials.json")?.[1]);
}

/** Present a reading; `proxy` is the point that stays on the surface, `slideSpeed` in metres a second. */
export function show(medium: Medium, reading: Reading, proxy: Triple | null, slideSpeed: number): void {
  const { isError, isPins } = medium;
  const { point, force } = reading;
  const vibration = vibrationOf(force, medium);
  const size = sizeText(reading, medium);
  setText("size", size);
  setText("height", surfaceText(reading, medium));
  setText("parts", partsText(reading, medium));
  setText("vibrates", vibration > 0 ? `vibrates ${vibration.toFixed(2)} N at ${force[4]!.toFixed(0)} Hz` : "");
  view.setProbe(point, force, `${size} ${isError ? "of bound" : isPins ? "%" : "N"}`, proxy);
  trace.add(sizeOf(force));
  play(medium, reading, slideSpeed);
}

/** Play the force, with the louder of the field's vibration and the texture that the probe slides over. */
function play(medium: Medium, { point, force }: Reading, slideSpeed: number): void {
  const { directions, isError, top } = medium;
  const size = sizeOf(force);
  const vibration = vibrationOf(force, medium);
  const side = directions.right.reduce((sum, direction, n) => sum + direction * force[n]!, 0) / (size || 1);
  const [texture, hertz] = slidOver(materials, point, slideSpeed, isError ? 0 : size);
  if (texture > vibration) sound.play(size / top, side, texture / top, hertz);
  else sound.play(size / top, side, vibration / top, force[4]!);
}
