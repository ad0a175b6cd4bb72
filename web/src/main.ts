// Entry point of the page of `touchfield view`, which opens a file, plays it, and lets a user probe its forces by pointer,
// keyboard, sound and game pad. Each module of `page/` is one part of the page with its own state. Its controls work once `wire`
// has run, and its `start` shows a new medium.
import { byId, bytesOf } from "./elements";
import type { Triple } from "./engine";
import { speakSoon } from "./page/announcer";
import { followAddress } from "./page/bookmark";
import * as brailleLine from "./page/braille_line";
import * as clock from "./page/clock";
import * as fieldChoice from "./page/field_choice";
import * as frames from "./page/frames";
import * as handLink from "./page/hand_link";
import { type Medium, medium } from "./page/medium";
import * as movie from "./page/movie";
import * as opening from "./page/opening";
import { sound, view } from "./page/outputs";
import * as player from "./page/player";
import * as pointer from "./page/pointer";
import * as probe from "./page/probe";
import * as probeControls from "./page/probe_controls";
import type { Read } from "./page/remote_file";
import * as saveControls from "./page/save_controls";
import * as shortcuts from "./page/shortcuts";
import * as slice from "./page/slice";
import * as soundControls from "./page/sound_controls";
import { latest, reportFault, setPageState, stamp, timings, waitFor } from "./page/status";
import { moveByPad } from "./page/steps";
import { compiled, decoder, hand } from "./page/threads";
import * as viewControls from "./page/view_controls";
import { Pads } from "./pads";
import type { Given } from "./panel";

async function start(): Promise<void> {
  stamp("start");
  for (const wire of [opening.wire, player.wire, slice.wire, fieldChoice.wire, probeControls.wire, soundControls.wire, viewControls.wire]) wire();
  for (const wire of [saveControls.wire, brailleLine.wire, pointer.wire, shortcuts.wire, handLink.wire]) wire();
  new Pads(moveByPad, shortcuts.press);
  probe.onField(() => {
    brailleLine.show();
    speakSoon();
  });
  await compiled;
  await openGiven();
}

/** Open the file that the page was given; without one, wait for a file, and have the decoder ready for it. */
async function openGiven(): Promise<void> {
  const given = byId("given-medium");
  const isEmpty = !given.textContent!.trim();
  if (isEmpty) {
    waitFor("");
    byId("empty").hidden = false;
  }
  setPageState("empty");
  if (isEmpty) return void (await decoder.request({ do: "warm", data: bytesOf("sample"), times: 14 }));
  movie.open(player.toggle, () => player.setPlaying(false));
  const figures = JSON.parse(byId("given-figures").textContent!) as Given;
  const source = byId("given-source").textContent!.trim() ? bytesOf("given-source") : null;
  await opening.openBytes(bytesOf("given-medium"), given.dataset.name ?? "medium.touch", figures, source);
  await followAddress();
}

/** Where a hand is that another program follows, and when. */
const followHand = latest(async (point: Triple, time: number) => {
  if (!medium) return;
  if (Math.abs(time - clock.time) > 0.5 / medium.head.rate) await frames.showNow(Math.min(time, medium.seconds));
  await probe.feelAt(point, true);
});

/** For tests, and for a page that has this one in a frame: what is open, and forces at points, newtons. */
Object.assign(window, {
  touchfield: {
    open: (data: ArrayLike<number>, name: string) => opening.openBytes(Uint8Array.from(data), name),
    read: (size: number, name: string, read: Read) => opening.openParts(size, name, async (from, to) => Uint8Array.from(await read(from, to))),
    follow: (data: ArrayLike<number>, name: string) => opening.follow(Uint8Array.from(data), name),
    hand: (at: Triple, time: number) => followHand(at, time),
    feel: (points: number[]) => decoder.request<Float64Array>({ do: "feel", points }).then((all) => [...all]),
    seek: (time: number) => frames.showNow(time).catch(reportFault),
    state: () => ({
      state: document.documentElement.dataset.state, playing: clock.isPlaying, movie: movie.position(), marks: timings, sound: sound.output,
      triangles: view.triangles, cones: view.cones, bodies: view.bodies, graphicsObjects: view.graphicsObjects,
      ...(medium ? stateOf(medium) : { force: null, field: null, hand: null, handFault: null }),
    }),
  },
});

function stateOf({ name, head, what }: Medium): object {
  return {
    name, head, what, time: clock.time, point: probe.point, force: [...probe.force], field: [...probe.field], hand: hand.rendered, handFault: hand.fault,
    axis: slice.axis, cut: slice.position, memory: frames.memory,
  };
}

start().catch((error: unknown) => {
  reportFault(error, "The page");
  byId("empty").hidden = true;
});
