// What the page reports of itself: whether a medium is ready, what it waits for, what it lacks, and faults.
import { Fault } from "../container";
import { byId, setText } from "../elements";
import { latestOf } from "../latest";
import { message } from "../saving";
import { medium } from "./medium";

export type PageState = "empty" | "opening" | "ready" | "fault";

export const isPageState = (state: PageState): boolean => document.documentElement.dataset.state === state;
export const setPageState = (state: PageState): void => void (document.documentElement.dataset.state = state);

/** When the latest of each step was reached, milliseconds since the page was loaded: for tests and benchmarks. */
export const timings: Record<string, number> = {};
export const stamp = (name: string): void => void (timings[name] = performance.now());

/** What the page lacks here; empty: nothing. */
export function notice(sentence: string): void {
  setText("notice", sentence);
  byId("notice").hidden = !sentence;
}

/** What the page waits for; empty: for nothing. */
export function waitFor(text: string): void {
  if (text) setText("waits", text);
  byId("loading").hidden = !text;
}

let stopPlaying = (): void => undefined;

/** Have a fault stop what goes on. */
export function onFault(stop: () => void): void {
  stopPlaying = stop;
}

export function reportFault(error: unknown, name = medium?.name ?? "the file"): void {
  const details = error as { fault?: string; message?: string; byte?: number | null };
  const where = details.byte == null ? "" : `, at byte ${details.byte.toLocaleString("en")}`;
  const reason = details.fault ? `${details.message} (${details.fault}${where})` : error instanceof Fault ? error.message : String(error);
  setText("fault", `${name} cannot be shown: ${reason}.`);
  byId("fault").hidden = false;
  message(`Cannot be saved: ${name} cannot be shown.`);
  setPageState("fault");
  stopPlaying();
  waitFor("");
  byId("empty").hidden = medium !== null;
}

/** The latest of several calls, whose errors are reported. */
export function latest<A extends unknown[]>(run: (...args: A) => Promise<void>): (...args: A) => void {
  return latestOf(run, reportFault);
}
