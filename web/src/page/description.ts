// Describes an open medium in words: in the header, the title, the figures and the first sentence that is spoken.
import { byId, setText } from "../elements";
import { figuresOf, millimetres } from "../panel";
import { WITHOUT_WEBGL } from "../speech";
import type { Medium } from "./medium";
import { view } from "./outputs";

const KEYS = "Arrow keys and Page Up and Down move the probe, f follows the surface, t says what is under it, question mark lists all keys.";

/** Write what a medium is into the page; its box and axes into the view. */
export function describe(medium: Medium): void {
  const { name, opened, head, directions, supplement: { figures }, isPins } = medium;
  byId("legend").hidden = false;
  document.title = `${name} – touchfield`;
  setText("name", name);
  setText("summary", summaryOf(medium));
  byId("labels").dataset.device = opened.records.device;
  view.start(head, directions, namesOf(medium));
  figuresOf(byId("figures"), byId("provenance"), opened, figures, isPins);
}

function summaryOf({ head, opened: { records }, isArray }: Medium): string {
  const kind = isArray ? `${head.shape[0]} × ${head.shape[1]} actuators` : head.objects ? `${head.objects} bodies` : "a force field";
  const duration = head.frames > 1 ? ` over ${(head.frames / head.rate).toPrecision(2)} s` : "";
  return `${kind}${duration}, for ${records.device || "a device"}`;
}

/** Labels of the box and of its axes. */
function namesOf({ opened: { records }, directions, isArray, lengths }: Medium): { box: string; axes: string[] } {
  const axes = lengths.map((m, n) => `${"xyz"[n]} ${directions.names[n]} · ${millimetres(m)}`.replace("  ", " "));
  return { box: `${isArray ? "actuators" : "workspace"} of ${records.device || "the device"}`, axes };
}

/** What is open, and how it is explored. */
export function greeting(medium: Medium): string {
  const lengths = medium.lengths.map(millimetres).join(" by ");
  return `${medium.name} is open: ${summaryOf(medium)}, ${lengths}. ${KEYS}${view.isFlat ? ` ${WITHOUT_WEBGL}` : ""}`;
}
