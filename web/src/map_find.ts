// Finds places by their names: by the start of the name, the start of a word, a part, or the class; else names that differ by
// a letter or two.
import { titleOf } from "./map_classes";
import type { Place } from "./map_record";
import type { Language } from "./map_text";

export interface Found {
  places: Place[];
  /** Whether nothing matched, and these are names that are written alike. */
  isSimilar: boolean;
}

/** A text without case, accents and punctuation. */
export const plain = (text: string): string =>
  text.toLowerCase().replaceAll("ß", "ss").normalize("NFD").replaceAll(/\p{M}/gu, "").replaceAll(/[^\p{L}\p{N}]+/gu, " ").trim();

const SIMILAR_LETTERS = 2;

/** How well a place answers to a text, 0 the best; 9: not at all. */
function rank(place: Place, wanted: string, language: Language): number {
  const name = plain(place.name);
  if (name === wanted) return 0;
  if (name.startsWith(wanted)) return 1;
  if (` ${name}`.includes(` ${wanted}`)) return 2;
  if (name.includes(wanted)) return 3;
  if (plain(titleOf(place.kind, language)).startsWith(wanted)) return 4;
  const words = wanted.split(" ");
  return words.length > 1 && words.every((word) => ` ${name} ${plain(titleOf(place.kind, language))}`.includes(` ${word}`)) ? 5 : 9;
}

/** Places by their names, the best first; of equal ones in the order that they have. */
export function find(places: Place[], text: string, language: Language): Found {
  const wanted = plain(text);
  if (!wanted) return { places: [], isSimilar: false };
  const ranked = places.map((place) => ({ place, value: rank(place, wanted, language) })).filter(({ value }) => value < 9);
  ranked.sort((a, b) => a.value - b.value);
  if (ranked.length) return { places: ranked.map(({ place }) => place), isSimilar: false };
  const limit = wanted.length < 4 ? 1 : SIMILAR_LETTERS;
  const similar = places.map((place) => ({ place, value: leastEdits(plain(place.name), wanted, limit) })).filter(({ value }) => value <= limit);
  similar.sort((a, b) => a.value - b.value);
  return { places: similar.map(({ place }) => place), isSimilar: similar.length > 0 };
}

/** The fewest letters to change from a wanted text to a name, to its start, or to one of its words. */
function leastEdits(name: string, wanted: string, limit: number): number {
  const candidates = [name, ...name.split(" ")].filter((word) => Math.abs(word.length - wanted.length) <= limit);
  return Math.min(limit + 1, ...candidates.map((word) => edits(word, wanted)));
}

/** Letters to change, add, or leave out (Levenshtein 1966). */
function edits(a: string, b: string): number {
  let row = Array.from({ length: b.length + 1 }, (_, n) => n);
  for (let i = 1; i <= a.length; i++) {
    const next = [i];
    for (let j = 1; j <= b.length; j++) next.push(Math.min(row[j]! + 1, next[j - 1]! + 1, row[j - 1]! + (a[i - 1] === b[j - 1] ? 0 : 1)));
    row = next;
  }
  return row[b.length]!;
}
