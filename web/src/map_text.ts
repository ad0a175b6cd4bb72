// The sentences of the page of maps, in English and German: names and classes, distances and directions.
import { titleOf } from "./map_classes";
import { boxOf, type Met, type Point } from "./map_model";
import type { Kind, Place, TactileMap } from "./map_record";

export type Language = "en" | "de";

const COMPASS = {
  en: ["east", "north-east", "north", "north-west", "west", "south-west", "south", "south-east"],
  de: ["im Osten", "im Nordosten", "im Norden", "im Nordwesten", "im Westen", "im Südwesten", "im Süden", "im Südosten"],
};
const PAPER = {
  en: ["to the right", "up right", "up", "up left", "to the left", "down left", "down", "down right"],
  de: ["rechts", "rechts oben", "oben", "links oben", "links", "links unten", "unten", "rechts unten"],
};

const ENGLISH = {
  open: "Open a map", contrast: "High contrast", keys: "Keys", other: "Deutsch", map: "Map", or: "or", label: "label", legend: "Legend",
  hint: "Arrow keys move the cursor, plus and minus zoom, slash finds a place, question mark lists all keys.",
  zoomIn: "Zoom in", zoomOut: "Zoom out", whole: "Whole map", left: "Move the map west", right: "Move the map east", up: "Move the map north", down: "Move the map south",
  speech: "Speech", sound: "Sound", vibration: "Vibration", on: "on", off: "off", noSpeech: "this browser has no speech", underCursor: "Under the cursor",
  find: "Find a place", findHint: "Name or class. Arrow keys choose, Enter goes there, Shift and Enter guides there.", results: "Places that were found",
  found: "found", similar: "similar", noFind: "nothing of that name", noNames: "This map has no names.", notDrawn: "not drawn, its place is here",
  guide: "Guide me", stopGuide: "Stop guiding", target: "guiding to", stopped: "no guiding", arrived: "arrived", noTarget: "No place was found yet: slash finds one.",
  features: "All places", more: "more: find them by name", nothing: "nothing here", edge: "edge of the map", nearest: "nearest place", zoom: "zoom", of: "of", wide: "wide", finest: "no larger step",
  wholeMap: "the whole map", empty: "Drop a map here", emptyHint: "or open one: a .touch file that touchfield map made. Files stay on this machine: the page uses no network.",
};

const GERMAN: typeof ENGLISH = {
  open: "Karte öffnen", contrast: "Hoher Kontrast", keys: "Tasten", other: "English", map: "Karte", or: "oder", label: "Beschriftung", legend: "Legende",
  hint: "Pfeiltasten bewegen den Zeiger, Plus und Minus ändern die Stufe, Schrägstrich sucht einen Ort, Fragezeichen nennt alle Tasten.",
  zoomIn: "Größer", zoomOut: "Kleiner", whole: "Ganze Karte", left: "Karte nach Westen", right: "Karte nach Osten", up: "Karte nach Norden", down: "Karte nach Süden",
  speech: "Sprache", sound: "Ton", vibration: "Vibration", on: "an", off: "aus", noSpeech: "dieser Browser hat keine Sprache", underCursor: "Unter dem Zeiger",
  find: "Ort suchen", findHint: "Name oder Art. Pfeiltasten wählen, Eingabe geht hin, Umschalt und Eingabe führt hin.", results: "Gefundene Orte",
  found: "gefunden", similar: "ähnlich", noFind: "kein solcher Name", noNames: "Diese Karte hat keine Namen.", notDrawn: "nicht gezeichnet, sein Platz ist hier",
  guide: "Hinführen", stopGuide: "Nicht mehr führen", target: "Führung zu", stopped: "keine Führung", arrived: "angekommen", noTarget: "Noch kein Ort gefunden: Schrägstrich sucht einen.",
  features: "Alle Orte", more: "weitere: Suche nach dem Namen", nothing: "hier ist nichts", edge: "Rand der Karte", nearest: "nächster Ort", zoom: "Stufe", of: "von", wide: "breit", finest: "keine größere Stufe",
  wholeMap: "die ganze Karte", empty: "Karte hier ablegen", emptyHint: "oder öffnen: eine .touch-Datei von touchfield map. Dateien bleiben auf diesem Gerät: Die Seite nutzt kein Netz.",
};

export type Key = keyof typeof ENGLISH;

/** Keys of the page, and what each does. */
export const KEY_LIST: Record<Language, [string, string][]> = {
  en: [
    ["Arrow keys", "move the cursor"], ["Ctrl and arrow keys", "to the next thing in this direction"], ["Shift and arrow keys", "next view of the map"], ["+ and -", "zoom"], ["Home", "whole map"],
    ["/", "find a place"], ["Enter or T", "everything under the cursor, and where it is"], ["G", "guide to the place that was found, or stop"], ["L", "list of all places"], ["S", "speech"], ["M", "sound"], ["V", "vibration"],
    ["H", "high contrast"], ["O", "open a map"], ["?", "this list"], ["Escape", "close this list; leave the search"],
  ],
  de: [
    ["Pfeiltasten", "bewegen den Zeiger"], ["Strg und Pfeiltasten", "zum nächsten Ding in dieser Richtung"], ["Umschalt und Pfeiltasten", "nächster Ausschnitt der Karte"], ["+ und -", "nächste und vorige Stufe"], ["Pos 1", "ganze Karte"],
    ["/", "Ort suchen"], ["Eingabe oder T", "alles unter dem Zeiger, und wo es ist"], ["G", "zum gefundenen Ort führen, oder nicht mehr"], ["L", "Liste aller Orte"], ["S", "Sprache"], ["M", "Ton"], ["V", "Vibration"],
    ["H", "hoher Kontrast"], ["O", "Karte öffnen"], ["?", "diese Liste"], ["Escape", "schließt diese Liste; verlässt die Suche"],
  ],
};

let language: Language = "en";

export const currentLanguage = (): Language => language;

export function setLanguage(next: Language): void {
  language = next;
}

/** A text of the page. */
export const t = (key: Key): string => (language === "de" ? GERMAN : ENGLISH)[key];

/** Name and class of a place. */
export const placeText = ({ name, kind }: Place): string => named([name], kind);

/** Name and class of what is met, or its class alone; a line that joins others may have one of several names. */
export const metText = ({ names, symbol }: Met): string => (symbol.role === "label" ? `${t("label")}: ` : "") + named(names, symbol.kind);

const MAX_NAMES = 3;

function named(names: string[], kind: Kind): string {
  const name = names.slice(0, MAX_NAMES).join(` ${t("or")} `);
  if (kind.name === "text" && name) return name;
  return name ? `${name}, ${titleOf(kind, language)}` : titleOf(kind, language);
}

const EIGHTH = Math.PI / 4;

/** One of eight directions: of a map a point of the compass, of a drawing one of a sheet. */
export function directionText(dx: number, dy: number, isMap: boolean): string {
  const n = (Math.round(Math.atan2(dy, dx) / EIGHTH) + 8) % 8;
  return (isMap ? COMPASS : PAPER)[language][n]!;
}

/** A length with two significant digits: metres, kilometres, or hundredths of the width of a drawing. */
export function lengthText(length: number, map: TactileMap): string {
  if (map.isDrawing) return percent(length / (boxOf(map)[2] - boxOf(map)[0]));
  const metres = Number(length.toPrecision(2));
  return metres < 1000 ? `${number(metres)} m` : `${number(metres / 1000)} km`;
}

const number = (value: number): string => value.toLocaleString(language, { maximumSignificantDigits: 2 });
const percent = (fraction: number): string => (language === "de" ? `${number(100 * fraction)} % der Breite` : `${number(100 * fraction)} % of the width`);

/** Where a point lies from another: "250 m north-east"; "" if they are the same for a finger. */
export function wayText(from: Point, to: Point, map: TactileMap): string {
  const [dx, dy] = [to[0] - from[0], to[1] - from[1]];
  if (!dx && !dy) return "";
  return `${lengthText(Math.hypot(dx, dy), map)} ${directionText(dx, dy, !map.isDrawing)}`;
}
