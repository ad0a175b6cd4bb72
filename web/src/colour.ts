// Maps numbers from 0 to 1 to colours of viridis, a perceptually uniform map (van der Walt and Smith, CC0),
// by nine of its colours.
const ANCHORS = [0x440154, 0x472d7b, 0x3b528b, 0x2c728e, 0x21918c, 0x28ae80, 0x5ec962, 0xaddc30, 0xfde725];

export type Colour = [number, number, number];

/** Red, green and blue, 0 to 255, of a share from 0 to 1. */
export function colourOf(share: number): Colour {
  const place = Math.min(Math.max(share, 0), 1) * (ANCHORS.length - 1);
  const n = Math.min(Math.floor(place), ANCHORS.length - 2);
  const [a, b] = [ANCHORS[n]!, ANCHORS[n + 1]!];
  const part = (shift: number): number => {
    const first = (a >> shift) & 255;
    return first + (place - n) * (((b >> shift) & 255) - first);
  };
  return [part(16), part(8), part(0)];
}

const BEYOND: Colour = [214, 31, 38];

/** 256 colours, and red for what is beyond what is allowed: red, green and blue in turn. */
export const TABLE: Uint8Array = Uint8Array.from({ length: 771 }, (_, n) => (n < 768 ? colourOf(Math.floor(n / 3) / 255) : BEYOND)[n % 3]!);

/** Where in the table a share stands, and one that is beyond. */
export const rowOf = (share: number, beyond: number): number => 3 * (share > beyond ? 256 : Math.min(255, Math.floor(255 * share)));
