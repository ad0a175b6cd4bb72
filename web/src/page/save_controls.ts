// The buttons that save the frame that is shown, or a range of frames.
import { byId } from "../elements";
import type { Recorded } from "../engine";
import { save, type Source } from "../saving";
import * as clock from "./clock";
import { medium } from "./medium";
import { isPageState } from "./status";
import { decoder } from "./threads";

export function wire(): void {
  byId("save-frame").onclick = (): void => void saveFrames(false);
  byId("save-range").onclick = (): void => void saveFrames(true);
}

/** Save what the form describes; of a file in parts all of its frames are fetched first. */
export function saveFrames(isRange: boolean): Promise<void> {
  return save(sourceOf(), isRange, async (recording) => {
    const { rate } = medium!.head;
    for (let n = recording.from; n < recording.from + recording.count; n++) await medium!.fetch(n / rate);
    return decoder.request<Recorded>({ do: "record", recording });
  });
}

/** What is saved; a text if there is nothing to save. */
function sourceOf(): Source | string {
  if (isPageState("fault")) return "the file cannot be shown, see above";
  return medium ? { name: medium.name, head: medium.head, time: clock.time } : "no file is open";
}
