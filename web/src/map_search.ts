// The search field with its list of places (a combobox by the ARIA authoring practices), and the list of all places by class.
import { byId } from "./elements";
import { find } from "./map_find";
import { classOf, titleOf } from "./map_classes";
import { sortedPlaces } from "./map_model";
import type { Kind, Place, TactileMap } from "./map_record";
import { currentLanguage, placeText, t } from "./map_text";

const MAX_RESULTS = 50;
const MAX_ROWS = 300;


function element<K extends keyof HTMLElementTagNameMap>(tag: K, text: string, parent: Element): HTMLElementTagNameMap[K] {
  const made = document.createElement(tag);
  made.textContent = text;
  parent.append(made);
  return made;
}

export interface SearchActions {
  goTo(place: Place): void;
  /** Guide to a place, from the cursor. */
  guideTo(place: Place): void;
  /** Where a place is from the cursor. */
  way(place: Place): string;
  say(sentence: string): void;
  /** Speak what a screen reader reads by itself. */
  speak(sentence: string): void;
  leave(): void;
}

export class Search {
  private readonly input = byId<HTMLInputElement>("find");
  private readonly results = byId<HTMLUListElement>("results");
  private places: Place[] = [];
  private found: Place[] = [];
  private selected = -1;

  constructor(private readonly actions: SearchActions) {
    this.input.addEventListener("input", () => this.look());
    this.input.addEventListener("keydown", (event) => this.press(event));
    this.results.addEventListener("click", (event) => {
      const row = (event.target as Element).closest("li");
      const place = this.found[[...this.results.children].indexOf(row!)];
      if (place) this.choose(place, false);
    });
  }

  open(map: TactileMap): void {
    this.places = sortedPlaces(map);
    this.clear();
    this.list(map.kinds);
    legend(map.kinds);
  }

  focus(): void {
    this.input.focus();
    this.input.select();
    if (!this.places.length) this.actions.say(t("noNames"));
  }

  // -- the search field ---------------------------------------------------------------------------------------------------

  private look(): void {
    const { places, isSimilar } = find(this.places, this.input.value, currentLanguage());
    this.found = places.slice(0, MAX_RESULTS);
    this.results.replaceChildren();
    for (const [n, place] of this.found.entries()) {
      const row = element("li", "", this.results);
      row.id = `result-${n}`;
      row.role = "option";
      element("b", placeText(place), row);
      element("span", this.actions.way(place), row);
    }
    this.select(isSimilar ? -1 : Math.min(0, this.found.length - 1));
    this.setExpanded(this.found.length > 0);
    if (!this.input.value.trim()) return;
    const first = this.found[0];
    const count = `${places.length} ${t(isSimilar ? "similar" : "found")}`;
    this.actions.say(first ? `${isSimilar ? `${t("noFind")}; ` : ""}${count}: ${placeText(first)}, ${this.actions.way(first)}` : t("noFind"));
  }

  private select(n: number): void {
    this.selected = n;
    for (const [i, row] of [...this.results.children].entries()) row.setAttribute("aria-selected", String(i === n));
    if (n < 0) return this.input.removeAttribute("aria-activedescendant");
    this.input.setAttribute("aria-activedescendant", `result-${n}`);
    this.results.children[n]!.scrollIntoView({ block: "nearest" });
  }

  private setExpanded(isExpanded: boolean): void {
    this.results.hidden = !isExpanded;
    this.input.setAttribute("aria-expanded", String(isExpanded));
  }

  private clear(): void {
    this.input.value = "";
    this.found = [];
    this.results.replaceChildren();
    this.select(-1);
    this.setExpanded(false);
  }

  private press(event: KeyboardEvent): void {
    const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (step && this.found.length) {
      const next = (Math.max(this.selected, step > 0 ? -1 : 0) + step + this.found.length) % this.found.length;
      this.select(next);
      this.actions.speak(`${placeText(this.found[next]!)}, ${this.actions.way(this.found[next]!)}`);
    } else if (event.key === "Enter") {
      const place = this.found[this.selected];
      if (place) this.choose(place, event.shiftKey);
      else this.actions.say(t("noFind"));
    } else if (event.key === "Escape") {
      this.clear();
      this.actions.leave();
    } else return;
    event.preventDefault();
    event.stopPropagation();
  }

  private choose(place: Place, isGuided: boolean): void {
    this.clear();
    this.actions.leave();
    if (isGuided) this.actions.guideTo(place);
    else this.actions.goTo(place);
  }

  // -- all places ---------------------------------------------------------------------------------------------------------

  /** Write the list of all places; the rows of a class when it is opened. */
  private list(kinds: Kind[]): void {
    const list = byId("list");
    list.replaceChildren();
    if (!this.places.length) element("p", t("noNames"), list).className = "small";
    for (const kind of kinds) {
      const own = this.places.filter((place) => place.kind === kind);
      if (!own.length) continue;
      const details = element("details", "", list);
      const summary = element("summary", "", details);
      summary.append(swatch(kind));
      summary.append(`${titleOf(kind, currentLanguage())} (${own.length})`);
      const rows = element("ul", "", details);
      details.addEventListener("toggle", () => details.open && this.fillRows(rows, own));
      details.addEventListener("focusin", () => this.renewRows(rows, own));
    }
  }

  private fillRows(rows: HTMLUListElement, places: Place[]): void {
    rows.replaceChildren();
    for (const place of places.slice(0, MAX_ROWS)) {
      const button = element("button", "", element("li", "", rows));
      button.type = "button";
      button.append(`${place.name}, `);
      element("span", this.actions.way(place), button);
      button.onclick = (): void => {
        this.actions.leave();
        this.actions.goTo(place);
      };
    }
    if (places.length > MAX_ROWS) element("li", `${places.length - MAX_ROWS} ${t("more")}`, rows).className = "small";
  }

  /** Write anew where places are from the cursor. */
  private renewRows(rows: HTMLUListElement, places: Place[]): void {
    for (const [n, button] of [...rows.querySelectorAll("button")].entries()) button.querySelector("span")!.textContent = this.actions.way(places[n]!);
  }
}

/** Write what the colours mean. */
function legend(kinds: Kind[]): void {
  const rows = byId("legend");
  rows.replaceChildren();
  for (const kind of kinds) {
    const row = element("li", "", rows);
    row.append(swatch(kind), titleOf(kind, currentLanguage()));
  }
}

/** The colour of a class: pins. */
function swatch({ name }: Kind): SVGSVGElement {
  const made = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  made.setAttribute("viewBox", "0 0 24 16");
  made.setAttribute("aria-hidden", "true");
  made.classList.add("swatch");
  for (const [n, scheme] of (["light", "dark"] as const).entries()) {
    for (const [x, y] of [[4, 4], [12, 4], [20, 4], [4, 12], [12, 12], [20, 12]]) {
      const pin = document.createElementNS("http://www.w3.org/2000/svg", "circle");
      for (const [key, value] of Object.entries({ cx: x, cy: y, r: 3.2, fill: classOf(name).colours[n]!, class: scheme })) pin.setAttribute(key, String(value));
      made.append(pin);
    }
  }
  return made;
}
