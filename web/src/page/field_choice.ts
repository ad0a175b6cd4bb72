// Which field is shown, where the source is there: decoded, source, or their difference; and the scale of what is shown.
import { byId } from "../elements";
import type { What } from "../engine";
import { differenceText } from "../panel";
import { showScale } from "../scale";
import * as clock from "./clock";
import * as frames from "./frames";
import { medium, type Medium } from "./medium";
import { trace, view } from "./outputs";
import { latest } from "./status";
import { decoder } from "./threads";

const FIELDS: What[] = ["decoded", "source", "difference"];

const fieldButtons = (): HTMLElement[] => [...document.querySelectorAll<HTMLElement>("[data-what]")];

export function wire(): void {
  for (const button of fieldButtons()) button.onclick = (): void => choose(button.dataset.what as What);
}

export function start(medium: Medium): void {
  byId("fields").hidden = !medium.supplement.hasSource;
  showScaleOf(medium);
}

export function chooseNext(): void {
  choose(FIELDS[(FIELDS.indexOf(medium?.what ?? "decoded") + 1) % FIELDS.length]!);
}

const choose = latest(async (what: What) => {
  if (!medium?.supplement.hasSource) return;
  medium.what = what;
  await decoder.request({ do: "of", what });
  showScaleOf(medium);
  await frames.showNow(clock.time);
});

function showScaleOf({ head, supplement: { figures }, isArray, isError, isPins, top, what }: Medium): void {
  view.scale(top, isError ? 1 + Number(figures?.source_share ?? 0) : Infinity);
  trace.start(top);
  showScale({
    quantity: isError ? "error" : isPins ? "height" : "force", isArray, isFlat: view.isFlat, top,
    difference: differenceText(figures, !!head.objects),
  });
  for (const button of fieldButtons()) button.setAttribute("aria-pressed", String(button.dataset.what === what));
}
