// The list of edits, with a button to go to each and one to take it back.
import type { Edits } from "./timeline_edits";
import { clockText } from "./timeline_lanes";
import type { Track } from "./timeline_track";

/** An edit in the list: a run of a track, its mute, or its offset. */
export interface Entry {
  track: number;
  kind: "run" | "mute" | "offset";
  run: number;
  text: string;
  from: number;
  to: number;
}

export function entriesOf(tracks: readonly Track[], edits: Edits): Entry[] {
  return tracks.flatMap((track, n) => {
    const own = edits[n]!;
    const whole = { track: n, run: 0, from: Math.max(0, track.startS(own)), to: track.endS(own) };
    const out: Entry[] = [];
    if (own.isMuted) out.push({ ...whole, kind: "mute", text: "muted" });
    if (own.offsetMs) out.push({ ...whole, kind: "offset", text: `${own.offsetMs > 0 ? "later by" : "earlier by"} ${Math.abs(own.offsetMs)} ms` });
    for (const [run, { first, stop, percent }] of own.runs.entries())
      out.push({ track: n, run, kind: "run", text: `${percent} %`, from: track.timeOf(first, own), to: track.timeOf(stop, own) });
    return out;
  });
}

function cell(row: HTMLTableRowElement, text: string): HTMLTableCellElement {
  const out = row.insertCell();
  out.textContent = text;
  return out;
}

function button(name: string, label: string, act: () => void): HTMLButtonElement {
  const out = document.createElement("button");
  out.type = "button";
  out.textContent = name;
  out.setAttribute("aria-label", label);
  out.onclick = act;
  return out;
}

const MAX_ROWS = 200;

/** Fill the table; `go` and `remove` are those of an entry. Returns how many edits have no row. */
export function showEntries(table: HTMLTableElement, tracks: readonly Track[], entries: readonly Entry[], go: (entry: Entry) => void, remove: (entry: Entry) => void): number {
  const body = table.tBodies[0]!;
  body.replaceChildren();
  for (const entry of entries.slice(0, MAX_ROWS)) {
    const row = body.insertRow();
    const name = tracks[entry.track]!.name;
    const what = `${name}, ${clockText(entry.from)} to ${clockText(entry.to)}, ${entry.text}`;
    for (const text of [name, clockText(entry.from), clockText(entry.to), entry.text]) cell(row, text);
    cell(row, "").append(button("Go to", `Go to ${what}`, () => go(entry)), " ", button("Remove", `Remove ${what}`, () => remove(entry)));
  }
  table.hidden = !entries.length;
  return Math.max(0, entries.length - MAX_ROWS);
}
