// Opens files: given with the page, chosen, dropped, read in parts, made of a picture of depth, or following of a live medium.
import { byId, onFileDrop, setText } from "../elements";
import type { Opened } from "../engine";
import type { Given } from "../panel";
import { isPicture, readPicture } from "../picture";
import { reliefOf } from "../relief";
import { message, prepareSaving } from "../saving";
import * as announcer from "./announcer";
import * as clock from "./clock";
import { showDepth } from "./depth";
import { describe, greeting } from "./description";
import * as fieldChoice from "./field_choice";
import * as forcePanel from "./force_panel";
import * as frames from "./frames";
import * as handLink from "./hand_link";
import * as jumps from "./jumps";
import { Medium, medium, setMedium, type Supplement } from "./medium";
import * as player from "./player";
import * as probe from "./probe";
import { type Read, RemoteFile } from "./remote_file";
import * as slice from "./slice";
import { isPageState, reportFault, setPageState, stamp, waitFor } from "./status";
import { decoder, hand } from "./threads";

const MAX_BYTES = 1 << 29;
const TOO_LARGE = { fault: "too large", message: `the page takes files up to ${MAX_BYTES >> 20} MiB`, byte: null };
const FILE_ALONE: Supplement = { figures: null, hasSource: false, remote: null };

/** A file that the decoder has opened; its bytes where they are all there. */
interface OpenedFile {
  opened: Opened;
  data: Uint8Array | null;
}

/** Serial number of the latest file that was to be opened: what belongs to an earlier one is dropped. */
let latestSerial = 0;

export function wire(): void {
  const chooser = byId<HTMLInputElement>("file");
  byId("open").onclick = choose;
  chooser.onchange = (): void => {
    const file = chooser.files?.[0];
    if (file) void openFile(file);
  };
  onFileDrop(document.body, (file) => void openFile(file));
}

/** Have the user choose a file. */
export function choose(): void {
  byId("file").click();
}

async function openFile(file: File): Promise<void> {
  if (file.size > MAX_BYTES) return reportFault(TOO_LARGE, file.name);
  const data = new Uint8Array(await file.arrayBuffer());
  await (isPicture(data, file.name) ? openPicture(data, file.name) : openBytes(data, file.name));
}

export async function openBytes(data: Uint8Array, name: string, figures: Given = null, source: Uint8Array | null = null): Promise<void> {
  await openAs(name, { figures, hasSource: !!source, remote: null }, async () => {
    if (data.length > MAX_BYTES) throw TOO_LARGE;
    return { opened: await decoder.request<Opened>({ do: "open", data, source }), data };
  });
}

/** Open the relief of a picture of depth, and report what was done. */
async function openPicture(data: Uint8Array<ArrayBuffer>, name: string): Promise<void> {
  let report = "";
  await openAs(name, FILE_ALONE, async (serial) => {
    const relief = reliefOf(await readPicture(data, name), name);
    if (serial !== latestSerial) return null;
    const { data: file, ...opened } = await decoder.request<Opened & { data: Uint8Array }>({ do: "relief", relief });
    report = `${relief.report}, ${(opened.ms / 1000).toFixed(1)} s.`;
    return { opened, data: file };
  });
  if (report && isPageState("ready")) message(report);
}

/** Open a file of so many bytes in parts. */
export async function openParts(size: number, name: string, read: Read): Promise<void> {
  const serial = latestSerial + 1; // that which `openAs` takes
  const remote = new RemoteFile(read, () => serial === latestSerial);
  await openAs(name, { ...FILE_ALONE, remote }, async () => {
    if (size > MAX_BYTES) throw TOO_LARGE;
    waitFor(`Fetching ${name}`);
    const opened = await remote.open(size);
    return opened && { opened, data: null };
  });
}

/** Open a file by `open`, which gets its serial number and returns null where another file was opened meanwhile. */
async function openAs(name: string, supplement: Supplement, open: (serial: number) => Promise<OpenedFile | null>): Promise<void> {
  const serial = ++latestSerial;
  stopFor(name);
  try {
    const file = await open(serial);
    if (serial !== latestSerial || !file) return;
    const opened = new Medium(name, file.opened, supplement);
    start(opened);
    stamp("described");
    await frames.showNow(0, true);
    if (serial !== latestSerial) return;
    setPageState("ready");
    waitFor("");
    handLink.start(file.data);
    announcer.sayInstead(greeting(opened));
  } catch (error) {
    if (serial === latestSerial) reportFault(error, name);
  }
}

/** Stop what is open, and wait for a file. */
function stopFor(name: string): void {
  hand.close();
  stamp("open");
  setPageState("opening");
  byId("empty").hidden = true;
  waitFor(`Decoding ${name}`);
  player.setPlaying(false);
  byId("fault").hidden = true;
}

/** Every part of the page starts with a new medium, before a frame of it is decoded. */
function start(opened: Medium): void {
  setMedium(opened);
  describe(opened);
  prepareSaving(opened.head);
  showDepth(opened);
  for (const startPart of [slice.start, probe.start, forcePanel.start, clock.start, frames.start, fieldChoice.start, jumps.start]) startPart(opened);
}

/** Show what follows of a live medium in place of what is open: the probe, the view and the slice stay. */
export async function follow(data: Uint8Array, name: string): Promise<void> {
  if (!medium || !isPageState("ready")) {
    await openBytes(data, name);
    return clock.chooseSpeed(1);
  }
  const serial = ++latestSerial;
  try {
    const opened = await decoder.request<Opened>({ do: "open", data, source: null });
    if (serial !== latestSerial) return;
    setMedium(medium.continuedBy(opened, name));
    setText("name", name);
    await frames.showNow(0, true);
    if (serial === latestSerial) handLink.start(data, true);
    if (!clock.isPlaying) player.setPlaying(true);
  } catch (error) {
    reportFault(error, name);
  }
}
