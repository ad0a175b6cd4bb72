// Computes the vibration of a hand that slides along a surface, from the materials that a file stores;
// `sound.ts` makes it heard. The table is untrusted: anything that is not a number is ignored, and nothing
// else of it is read.

type Point = readonly [number, number, number];

interface Material {
  box: [Point, Point] | null;
  speeds: number[];
  forces: number[];
  /** Newtons rms, by speed, force and band. */
  levels: number[][][];
}

const isRow = (row: unknown): row is number[] => Array.isArray(row) && row.length > 0 && row.every((v) => Number.isFinite(v));

/** Bands and materials of a table; none where it is no table. Those of one object alone are left out. */
export function materialsOf(text: string | undefined): { bands: number[]; materials: Material[] } {
  const none = { bands: [], materials: [] };
  try {
    const { bands_hz: bands, materials } = JSON.parse(text ?? "null") ?? {};
    if (!isRow(bands) || !Array.isArray(materials)) return none;
    const stored = materials.slice(0, 64).filter((material) => material && material.object == null && isRow(material.speeds_m_s) && isRow(material.forces_n));
    const found = stored.map((material): Material => ({ box: material.box_m ?? null, speeds: material.speeds_m_s, forces: material.forces_n, levels: material.texture_rms_n }));
    const isWhole = (material: Material): boolean =>
      material.levels?.length === material.speeds.length && material.levels.every((row) => row?.length === material.forces.length && row.every((b) => isRow(b) && b.length === bands.length));
    return { bands, materials: found.filter(isWhole) };
  } catch {
    return none;
  }
}

/** Neighbours of a value in a rising row, and the weight of the second; below the first it fades to nothing. */
function between(row: number[], value: number): [number, number, number, number] {
  const last = row.length - 1;
  if (value <= row[0]!) return [0, 0, 0, Math.max(value / row[0]!, 0)];
  const at = row.findIndex((v) => v >= value);
  if (at < 0) return [last, last, 0, 1];
  return [at - 1, at, (value - row[at - 1]!) / (row[at]! - row[at - 1]!), 1];
}

/** Newtons rms and frequency of the loudest third of an octave where a probe slides; zeros where nothing is heard. */
export function slidOver(table: ReturnType<typeof materialsOf>, point: Point, speed: number, force: number): [number, number] {
  const material = table.materials.find(({ box }) => !box || point.every((v, n) => v >= box[0][n]! && v <= box[1][n]!));
  if (!material || !(speed > 0) || !(force > 0)) return [0, 0];
  const [a, b, s, soft] = between(material.speeds, speed);
  const [c, d, f, light] = between(material.forces, force);
  let [loudest, hertz] = [0, 0];
  table.bands.forEach((band, n) => {
    const at = (i: number, j: number): number => material.levels[i]![j]![n]!;
    const level = soft * light * ((1 - s) * ((1 - f) * at(a, c) + f * at(a, d)) + s * ((1 - f) * at(b, c) + f * at(b, d)));
    if (level > loudest) [loudest, hertz] = [level, band];
  });
  return [loudest, hertz];
}
