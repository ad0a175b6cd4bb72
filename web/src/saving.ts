// Saves the frames that the page shows as a new `.touch` file, with the error bound that the user chose.
import { byId, input, setText } from "./elements";
import type { Head, Recorded, Recording } from "./engine";

export interface Source {
  name: string;
  head: Head;
  time: number;
}

type Record = (recording: Recording) => Promise<Recorded>;

/** Report in the status line of the form. */
export const message = (text: string): void => setText("saved", text);

const bytes = (n: number): string => (n < 10000 ? `${n} bytes` : n < 1e7 ? `${(n / 1000).toFixed(1)} kB` : `${(n / 1e6).toFixed(1)} MB`);

/** A bound in four digits, never above it; a number that is a rounding error off one of four digits is that. */
function roundedDown(bound: number): number {
  const unit = 10 ** (Math.floor(Math.log10(bound)) - 3);
  return bound > 0 ? +(unit * Math.floor((bound / unit) * (1 + 1e-9))).toPrecision(4) : 0;
}

/** The fields of the form for a file: all frames, and the bound of the file if it has one. */
export function prepareSaving(head: Head): void {
  for (const id of ["save-from", "save-to"]) input(id).max = String(head.frames - 1);
  input("save-from").value = "0";
  input("save-to").value = String(head.frames - 1);
  input("save-k").value = String(roundedDown(100 * (head.weber > 0 ? head.weber : 0.1)));
  input("save-f0").value = String(roundedDown(head.weber > 0 || head.threshold > 0 ? head.threshold : 0.05));
  byId<HTMLButtonElement>("save-range").hidden = head.frames < 2;
  byId("saving").hidden = false;
  message(head.objects ? "Cannot be saved: the file has the coder objects, and the page saves fields of coder touch." : "");
}

/** The frames that a button saves; a text if the form has none. */
function framesOf(source: Source, isRange: boolean): [number, number] | string {
  const last = source.head.frames - 1;
  if (!isRange) {
    const frame = Math.min(Math.round(source.time * source.head.rate), last);
    return [frame, frame];
  }
  const [from, to] = [input("save-from").valueAsNumber, input("save-to").valueAsNumber];
  const fits = Number.isInteger(from) && Number.isInteger(to) && from >= 0 && from <= to && to <= last;
  return fits ? [from, to] : `frames from 0 to ${last}, the first not after the last`;
}

/** The recording that the form describes; a text if it describes none. */
function recordingOf(source: Source, isRange: boolean): Recording | string {
  const frames = framesOf(source, isRange);
  if (typeof frames === "string") return frames;
  const [weber, threshold] = [input("save-k").valueAsNumber / 100, input("save-f0").valueAsNumber];
  if (!(weber >= 0.001 && weber < 1)) return "an error of 0.1 to below 100 percent of the force";
  if (!(threshold >= 0 && threshold <= 1e30)) return "an error of 0 newtons or more";
  return { from: frames[0], count: frames[1] - frames[0] + 1, weber, threshold, name: source.name };
}

function download(data: Uint8Array<ArrayBuffer>, name: string): void {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([data], { type: "application/octet-stream" }));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60000);
}

let isBusy = false;

/** Save frames of a file, and report it in the status line; `source` is a text if there is nothing to save. */
export async function save(source: Source | string, isRange: boolean, record: Record): Promise<void> {
  if (isBusy) return;
  if (typeof source === "string") return message(`Cannot be saved: ${source}.`);
  const recording = recordingOf(source, isRange);
  if (typeof recording === "string") return message(`Cannot be saved: the page needs ${recording}.`);
  const { from, count } = recording;
  const name = `${source.name.replace(/\.(touch|png|npy)$/i, "")}-${count > 1 ? `${from}-${from + count - 1}` : from}.touch`;
  isBusy = true;
  message("Saving …");
  try {
    const { data, ratio, ms } = await record(recording);
    download(data, name);
    const frames = count > 1 ? `${count} frames` : "1 frame";
    message(`Saved ${name}: ${frames}, ${bytes(data.length)}, largest error ${(100 * ratio).toFixed(0)} % of the error bound, ${(ms / 1000).toFixed(1)} s.`);
  } catch (error) {
    message(`Cannot be saved: ${(error as { message?: string }).message ?? String(error)}.`);
  }
  isBusy = false;
}
