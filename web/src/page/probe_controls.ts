// The controls of the probe: the button that has it follow the surface, and the slider that presses it in.
import { byId, setPressed } from "../elements";
import { say } from "../speech";
import * as clock from "./clock";
import { showDepth } from "./depth";
import * as frames from "./frames";
import { medium } from "./medium";
import * as probe from "./probe";
import * as walk from "./surface_walk";

export function wire(): void {
  byId("follow").onclick = toggleSurface;
  byId("depth").oninput = (): void => {
    if (!medium) return;
    showDepth(medium);
    frames.show(clock.time);
  };
}

export function toggleSurface(): void {
  walk.choose(!walk.isChosen);
  setPressed("follow", walk.isChosen);
  if (!walk.isChosen) walk.leave();
  if (medium) probe.feel(probe.point);
  say(walk.isChosen ? "The probe follows the surface: arrow keys move over it as over a map." : "The probe moves freely.");
}
