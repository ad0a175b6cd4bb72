// The movie that a page may have beside the touch; while both play, it is the clock of both.
import { byId, bytesOf } from "../elements";

let video: HTMLVideoElement | null = null;
/** Seconds of the movie when the touch starts. */
let offset = 0;

/** Show the movie that the page was given, if any. */
export function open(onClick: () => void, onEnd: () => void): void {
  const given = byId("given-movie");
  if (!given.textContent!.trim()) return;
  video = byId<HTMLVideoElement>("video");
  video.src = URL.createObjectURL(new Blob([bytesOf("given-movie")], { type: given.dataset.type! }));
  offset = Number(given.dataset.at);
  byId("movie").hidden = false;
  video.onclick = onClick;
  video.onended = onEnd;
}

/** Seconds of the movie. */
export const position = (): number | undefined => video?.currentTime;

/** Seconds of the medium; null: there is no movie. */
export const time = (): number | null => video && video.currentTime - offset;

/** Go to a time of the medium. */
export function seek(time: number): void {
  if (video) video.currentTime = time + offset;
}

/** Play; browsers play no slower than a tenth of the speed of the movie. */
export async function play(speed: number): Promise<void> {
  if (!video) return;
  video.playbackRate = Math.max(speed, 0.1);
  if (video.ended) video.currentTime = 0;
  await video.play();
}

export const pause = (): void => video?.pause();
