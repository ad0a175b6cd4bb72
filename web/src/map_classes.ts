// The classes of maps: names, colours, and for ears a sound. Names are those of symbols.toml, which
// tests/viewer/test_map_page.py compares.
import type { Kind } from "./map_record";
import type { Language } from "./map_text";

export interface MapClass {
  en: string;
  de: string;
  /** Of pins, on light and on dark. */
  colours: [string, string];
  /** Hertz of its sound. */
  hertz: number;
}

export const CLASSES: Record<string, MapClass> = {
  wall: { en: "wall", de: "Wand", colours: ["#1f2937", "#f3f4f6"], hertz: 330 },
  road: { en: "road", de: "Straße", colours: ["#1f2937", "#f3f4f6"], hertz: 220 },
  rail: { en: "railway", de: "Bahn", colours: ["#86198f", "#f0abfc"], hertz: 165 },
  path: { en: "path", de: "Weg", colours: ["#9a3412", "#fdba74"], hertz: 294 },
  entrance: { en: "entrance", de: "Eingang", colours: ["#b91c1c", "#fca5a5"], hertz: 784 },
  stop: { en: "stop", de: "Haltestelle", colours: ["#7e22ce", "#d8b4fe"], hertz: 659 },
  crossing: { en: "crossing", de: "Übergang", colours: ["#a16207", "#fde047"], hertz: 698 },
  stairs: { en: "stairs or lift", de: "Treppe oder Aufzug", colours: ["#be185d", "#f9a8d4"], hertz: 587 },
  place: { en: "place", de: "Ort", colours: ["#c2410c", "#ff9d66"], hertz: 880 },
  building: { en: "building", de: "Gebäude", colours: ["#57534e", "#a8a29e"], hertz: 131 },
  water: { en: "water", de: "Wasser", colours: ["#0369a1", "#7dd3fc"], hertz: 98 },
  paved: { en: "pitch, square or parking", de: "Platz", colours: ["#6d5b2b", "#d6c48a"], hertz: 147 },
  green: { en: "park or wood", de: "Park oder Wald", colours: ["#15803d", "#86efac"], hertz: 117 },
  solid: { en: "line", de: "Linie", colours: ["#1f2937", "#f3f4f6"], hertz: 220 },
  dashed: { en: "dashed line", de: "Strichlinie", colours: ["#1d4ed8", "#93c5fd"], hertz: 262 },
  dotted: { en: "dotted line", de: "Punktlinie", colours: ["#b91c1c", "#fca5a5"], hertz: 294 },
  fill1: { en: "shade 1", de: "Fläche 1", colours: ["#0369a1", "#7dd3fc"], hertz: 98 },
  fill2: { en: "shade 2", de: "Fläche 2", colours: ["#15803d", "#86efac"], hertz: 110 },
  fill3: { en: "shade 3", de: "Fläche 3", colours: ["#a16207", "#fde047"], hertz: 124 },
  fill4: { en: "shade 4", de: "Fläche 4", colours: ["#57534e", "#a8a29e"], hertz: 139 },
  fill5: { en: "shade 5", de: "Fläche 5", colours: ["#be185d", "#f9a8d4"], hertz: 156 },
  room: { en: "room", de: "Raum", colours: ["#475569", "#cbd5e1"], hertz: 175 },
  door: { en: "door, a gap in a wall", de: "Tür, eine Lücke in der Wand", colours: ["#b91c1c", "#fca5a5"], hertz: 740 },
  stream: { en: "stream", de: "Bach", colours: ["#0369a1", "#7dd3fc"], hertz: 104 },
};

/** A word of a drawing, which has no symbol. */
const TEXT: MapClass = { en: "text", de: "Text", colours: ["#334155", "#cbd5e1"], hertz: 523 };
const UNKNOWN: MapClass = { en: "", de: "", colours: ["#334155", "#cbd5e1"], hertz: 247 };

export const classOf = (kind: string): MapClass => (Object.hasOwn(CLASSES, kind) ? CLASSES[kind]! : kind === "text" ? TEXT : UNKNOWN);

/** The name of a class; of one that the page does not know, that of the file. */
export const titleOf = ({ name, title }: Kind, language: Language): string => classOf(name)[language] || title || name;
