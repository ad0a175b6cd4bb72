// The buttons of sound, rumble and the scan of a line, and the slider of their gain.
import { byId, input, setPressed, setText } from "../elements";
import { medium } from "./medium";
import { sound } from "./outputs";
import * as probe from "./probe";

const SCAN_MS = 3000;
const STEP_MS = 25; // of a scan

let timer = 0;

export function wire(): void {
  byId("sound").onclick = toggle;
  byId("rumble").onclick = toggleRumble;
  byId("scan").onclick = scan;
  byId("gain").oninput = (): void => {
    sound.gain = Number(input("gain").value) / 100;
    setText("gain-value", `${Math.round(100 * sound.gain)} %`);
    if (medium) probe.showForce();
  };
}

export function toggle(): void {
  void turn(!sound.isOn);
}

async function turn(on: boolean): Promise<void> {
  setPressed("sound", on);
  await sound.sound(on);
}

export function toggleRumble(): void {
  sound.rumble(!sound.isRumbling);
  setPressed("rumble", sound.isRumbling);
}

/** Read a line of the field through the probe, from the left to the right, as sound. */
export function scan(): void {
  if (!medium) return;
  window.clearInterval(timer);
  const scanned = medium;
  const back = probe.point;
  const start = performance.now();
  setPressed("scan", true);
  void turn(true);
  timer = window.setInterval(() => {
    const fraction = (performance.now() - start) / SCAN_MS;
    if (fraction < 1) return probe.feel(scanned.lineThrough(back, [fraction])[0]!);
    window.clearInterval(timer);
    setPressed("scan", false);
    probe.feel(back);
  }, STEP_MS);
}
