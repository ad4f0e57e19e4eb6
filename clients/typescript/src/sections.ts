import { decompress } from "./zstd.js";

/** A closed contour, counter-clockwise; each array has one element per point. */
export interface Ring {
  /** Particle ids; a particle has the same id in every section. */
  ids: Uint32Array;
  /** Micrometres. */
  x: Float32Array;
  /** Micrometres. */
  y: Float32Array;
}

/** Entry of a section in the index of the file. */
export interface SectionEntry {
  index: number;
  /** Time step; fractional for a section that was added to mend a slab. */
  step: number;
  /** Position along the tube, micrometres from the isthmus end. */
  z_um: number;
  /** True for a section that was added to mend a slab. */
  added: boolean;
  /** Number of points of the inner contour. */
  innerPoints: number;
  /** Number of points of the outer contour. */
  outerPoints: number;
}

/** A cross section. */
export interface Section extends SectionEntry {
  /** Boundary of the lumen. */
  inner: Ring;
  /** Boundary of the tissue. */
  outer: Ring;
}

/** Header of the file. */
export interface SectionsHeader {
  /** Unit of lengths. */
  units: "um";
  engine: string;
  preset: string;
  seed: number;
  digest: string;
  length_mm: number;
}

const MAGIC = "OVISECT\n";
const END_MAGIC = "OVISEND\n";
const [HEADER_MAX, POINTS_MAX, ENTRY, TRAILER] = [1 << 20, 1 << 24, 48, 64];

function damaged(what: string): never {
  throw new Error(`sections.bin is damaged: ${what}`);
}

/** All cross sections of a model, read from `sections.bin`. Each is decoded on access. */
export class Sections implements Iterable<Section> {
  readonly header: SectionsHeader;
  /** One entry per section, isthmus end first. */
  readonly entries: readonly SectionEntry[];
  readonly #stored: Uint8Array[];

  private constructor(header: SectionsHeader, entries: SectionEntry[], stored: Uint8Array[]) {
    this.header = header;
    this.entries = entries;
    this.#stored = stored;
  }

  /**
   * Parses the file and checks the hash of all its bytes.
   *
   * Insecure pages have no hash function; there, only the structure is checked.
   *
   * @throws Error if the file is damaged.
   */
  static async parse(file: ArrayBuffer | Uint8Array): Promise<Sections> {
    const bytes = file instanceof Uint8Array ? file : new Uint8Array(file);
    const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    const text = (from: number, to: number) => new TextDecoder().decode(bytes.subarray(from, to));
    const end = bytes.length - TRAILER;
    if (end < 16 || text(0, 8) !== MAGIC || text(bytes.length - 8, bytes.length) !== END_MAGIC) damaged("no magic number");
    if (view.getUint32(8, true) !== 1) damaged("its version is not 1");
    const count = Number(view.getBigUint64(end + 8, true));
    const index = Number(view.getBigUint64(end, true));
    let at = 16 + view.getUint32(12, true);
    if (at - 16 > HEADER_MAX || index < at || index + count * ENTRY !== end) damaged("its parts do not fill it");
    const header = JSON.parse(text(16, at)) as SectionsHeader;
    if (globalThis.crypto?.subtle) {
      const hash = new Uint8Array(await crypto.subtle.digest("SHA-256", bytes.subarray(0, end + 24) as BufferSource));
      if (hash.some((byte, i) => byte !== bytes[end + 24 + i])) damaged("its bytes have another hash");
    }
    const [entries, stored]: [SectionEntry[], Uint8Array[]] = [[], []];
    for (let i = 0; i < count; i++) {
      const entry = index + i * ENTRY;
      const u32 = (offset: number) => view.getUint32(entry + offset, true);
      const [length, innerPoints, outerPoints] = [u32(8), u32(12), u32(16)];
      if (Number(view.getBigUint64(entry, true)) !== at || at + length > index) damaged(`section ${i} lies elsewhere`);
      if (Math.max(innerPoints, outerPoints) > POINTS_MAX) damaged(`section ${i} has too many points`);
      const [step, z_um] = [view.getFloat64(entry + 24, true), view.getFloat64(entry + 32, true)];
      entries.push({ index: i, step, z_um, added: u32(20) === 1, innerPoints, outerPoints });
      stored.push(bytes.subarray(at, at + length));
      at += length;
    }
    if (at !== index) damaged("there are gaps between its sections");
    return new Sections(header, entries, stored);
  }

  get length(): number {
    return this.entries.length;
  }

  /**
   * Returns the contours of a section.
   *
   * @throws RangeError if there is no such section.
   */
  section(index: number): Section {
    const [entry, stored] = [this.entries[index], this.#stored[index]];
    if (!entry || !stored) throw new RangeError(`there is no section ${index} among ${this.length}`);
    const { innerPoints, outerPoints } = entry;
    const planes = decompress(stored, 12 * (innerPoints + outerPoints));
    return { ...entry, inner: ring(planes, 0, innerPoints), outer: ring(planes, 12 * innerPoints, outerPoints) };
  }

  *[Symbol.iterator](): Iterator<Section> {
    for (let index = 0; index < this.length; index++) yield this.section(index);
  }
}

function ring(planes: Uint8Array, from: number, points: number): Ring {
  const [ids, x, y] = [0, 1, 2].map((i) => plane(planes, from + 4 * i * points, points));
  return { ids: new Uint32Array(ids!), x: new Float32Array(x!), y: new Float32Array(y!) };
}

/**
 * Decodes the numbers of a plane: differences from the previous number, in four layers of bytes.
 */
function plane(bytes: Uint8Array, from: number, points: number): ArrayBuffer {
  const numbers = new Int32Array(points);
  const layer = (k: number) => bytes.subarray(from + k * points, from + (k + 1) * points);
  const [b0, b1, b2, b3] = [layer(0), layer(1), layer(2), layer(3)];
  let number = 0;
  for (let i = 0; i < points; i++) {
    const mapped = b0[i]! | (b1[i]! << 8) | (b2[i]! << 16) | (b3[i]! << 24);
    number = (number + ((mapped >>> 1) ^ -(mapped & 1))) | 0;
    numbers[i] = number;
  }
  return numbers.buffer;
}
