// Maps numbers from 0 to 1 to colours of viridis, a perceptually uniform map (van der Walt and Smith, CC0),
// by nine of its colours.
const ANCHORS = [0x440154, 0x472d7b, 0x3b528b, 0x2c728e, 0x21918c, 0x28ae80, 0x5ec962, 0xaddc30, 0xfde725];

export type Colour = [number, number, number];

/** Red, green and blue, 0 to 255, of a fraction from 0 to 1. */
export function colourOf(fraction: number): Colour {
  const position = Math.min(Math.max(fraction, 0), 1) * (ANCHORS.length - 1);
  const n = Math.min(Math.floor(position), ANCHORS.length - 2);
  const [a, b] = [ANCHORS[n]!, ANCHORS[n + 1]!];
  const part = (shift: number): number => {
    const first = (a >> shift) & 255;
    return first + (position - n) * (((b >> shift) & 255) - first);
  };
  return [part(16), part(8), part(0)];
}

const ABOVE_LIMIT: Colour = [214, 31, 38];

/** 256 colours, and red above the error bound: red, green and blue in turn. */
export const TABLE: Uint8Array = Uint8Array.from({ length: 771 }, (_, n) => (n < 768 ? colourOf(Math.floor(n / 3) / 255) : ABOVE_LIMIT)[n % 3]!);

/** The row of the table for a fraction, and for one above a limit. */
export const rowOf = (fraction: number, limit: number): number => 3 * (fraction > limit ? 256 : Math.min(255, Math.floor(255 * fraction)));
