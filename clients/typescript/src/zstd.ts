/** A decoder of Zstandard frames (RFC 8878) without dictionaries: neither browsers nor Node 20 have one. */

/** A table of a finite state entropy code, indexed by its state. */
interface Fse {
  log: number;
  symbols: Uint8Array;
  bits: Uint8Array;
  bases: Uint16Array;
}

/** A table of a Huffman code, indexed by the next `log` bits. */
interface Huffman {
  log: number;
  symbols: Uint8Array;
  bits: Uint8Array;
}

/** How the values of a code are made: `base[code]` and as many more bits as `extra[code]`. */
interface Values {
  base: number[];
  extra: number[];
}

const MAGIC = 0xfd2fb528;
const BLOCK_MAX = 1 << 17;

const LITERAL_LENGTHS = values(0, [
  ...[0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0],
  ...[1, 1, 1, 1, 2, 2, 3, 3, 4, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16],
]);
const MATCH_LENGTHS = values(3, [
  ...Array<number>(32).fill(0),
  ...[1, 1, 1, 1, 2, 2, 3, 3, 4, 4, 5, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16],
]);
const DEFAULTS = {
  literals: fseTable(6, [
    ...[4, 3, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 1, 1, 1, 2, 2, 2, 2, 2, 2, 2, 2, 2, 3, 2, 1, 1, 1, 1, 1, -1, -1, -1, -1],
  ]),
  offsets: fseTable(5, [
    ...[1, 1, 1, 1, 1, 1, 2, 2, 2, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, -1, -1, -1, -1, -1],
  ]),
  matches: fseTable(6, [1, 4, 3, 2, 2, 2, 2, 2, 2, ...Array<number>(37).fill(1), -1, -1, -1, -1, -1, -1, -1]),
};

/** Values whose ranges follow one another. */
function values(first: number, extra: number[]): Values {
  const base: number[] = [];
  let next = first;
  for (const bits of extra) {
    base.push(next);
    next += 2 ** bits;
  }
  return { base, extra };
}

function damaged(what: string): never {
  throw new Error(`the Zstandard frame is damaged: ${what}`);
}

/** Position of the highest set bit. */
function highest(value: number): number {
  return 31 - Math.clz32(value);
}

/** Reads bits from the first byte on, lowest first. */
class Forward {
  #position = 0;
  constructor(readonly bytes: Uint8Array) {}

  peek(count: number): number {
    let value = 0;
    for (let bit = 0; bit < count; bit++) {
      const at = this.#position + bit;
      value |= (((this.bytes[at >> 3] ?? 0) >> (at & 7)) & 1) << bit;
    }
    return value;
  }

  skip(count: number): void {
    this.#position += count;
    if (this.#position > this.bytes.length * 8) damaged("a table is cut off");
  }

  read(count: number): number {
    const value = this.peek(count);
    this.skip(count);
    return value;
  }

  /** Number of bytes that were read, at least in part. */
  get used(): number {
    return (this.#position + 7) >> 3;
  }
}

/** Reads bits from the last byte on, highest first. Before the first byte there are zeros. */
class Backward {
  /** Number of bits that are left; negative if more were read than there are. */
  left: number;
  constructor(readonly bytes: Uint8Array) {
    const last = bytes[bytes.length - 1];
    if (!last) damaged("a bit stream has no end");
    this.left = (bytes.length - 1) * 8 + highest(last);
  }

  /** The next bits, at most 25. */
  peek(count: number): number {
    const from = this.left - count;
    const at = from >> 3;
    const { bytes } = this;
    // Indexing outside the array gives undefined, which the operators take as 0.
    const word = bytes[at]! | (bytes[at + 1]! << 8) | (bytes[at + 2]! << 16) | (bytes[at + 3]! << 24);
    return (word >>> (from & 7)) & ((1 << count) - 1);
  }

  /** The next bits, at most 32. */
  read(count: number): number {
    if (count > 16) return this.read(count - 16) * 65536 + this.read(16);
    const value = this.peek(count);
    this.left -= count;
    return value;
  }
}

function fseTable(log: number, counts: number[]): Fse {
  const size = 1 << log;
  const [symbols, bits, bases] = [new Uint8Array(size), new Uint8Array(size), new Uint16Array(size)];
  const next = counts.map((count) => Math.abs(count));
  let end = size;
  counts.forEach((count, symbol) => {
    if (count === -1) symbols[--end] = symbol;
  });
  let at = 0;
  counts.forEach((count, symbol) => {
    for (let i = 0; i < count; i++) {
      symbols[at] = symbol;
      do at = (at + (size >> 1) + (size >> 3) + 3) & (size - 1);
      while (at >= end);
    }
  });
  for (let state = 0; state < size; state++) {
    const value = next[symbols[state]!]!++;
    bits[state] = log - highest(value);
    bases[state] = (value << bits[state]!) - size;
  }
  return { log, symbols, bits, bases };
}

/** Reads the description of a table; gives also the number of its bytes. */
function readFse(bytes: Uint8Array, maxLog: number, maxSymbol: number): [Fse, number] {
  const reader = new Forward(bytes);
  const log = reader.read(4) + 5;
  if (log > maxLog) damaged("a table is too large");
  const counts: number[] = [];
  let remaining = 1 << log;
  while (remaining > 0) {
    const width = highest(remaining + 1) + 1;
    const short = (1 << width) - 2 - remaining;
    let value = reader.peek(width);
    const low = value & ((1 << (width - 1)) - 1);
    if (low < short) {
      reader.skip(width - 1);
      value = low;
    } else {
      reader.skip(width);
      if (value >= 1 << (width - 1)) value -= short;
    }
    counts.push(value - 1);
    remaining -= Math.abs(value - 1);
    if (value === 1) {
      let more;
      do {
        more = reader.read(2);
        for (let i = 0; i < more; i++) counts.push(0);
      } while (more === 3);
    }
    if (counts.length > maxSymbol + 1) damaged("a table has too many symbols");
  }
  if (remaining < 0) damaged("the probabilities of a table do not add up");
  return [fseTable(log, counts), reader.used];
}

/** Reads the description of a Huffman code; gives also the number of its bytes. */
function readHuffman(bytes: Uint8Array): [Huffman, number] {
  const first = bytes[0] ?? damaged("a Huffman code is missing");
  let weights: number[] = [];
  let used = 1;
  if (first >= 128) {
    const count = first - 127;
    used += (count + 1) >> 1;
    for (let i = 0; i < count; i++) weights.push((bytes[1 + (i >> 1)]! >> (i & 1 ? 0 : 4)) & 15);
  } else {
    used += first;
    weights = readWeights(bytes.subarray(1, used));
  }
  if (bytes.length < used) damaged("a Huffman code is cut off");
  const total = weights.reduce((sum, weight) => sum + ((1 << weight) >> 1), 0);
  const log = highest(total) + 1;
  const left = (1 << log) - total;
  if (total === 0 || log > 11 || left & (left - 1)) damaged("the weights of a Huffman code do not add up");
  weights.push(highest(left) + 1);
  const [symbols, bits] = [new Uint8Array(1 << log), new Uint8Array(1 << log)];
  let at = 0;
  for (let weight = 1; weight <= log; weight++) {
    weights.forEach((own, symbol) => {
      if (own !== weight) return;
      const end = at + (1 << (weight - 1));
      symbols.fill(symbol, at, end);
      bits.fill(log + 1 - weight, at, end);
      at = end;
    });
  }
  return [{ log, symbols, bits }, used];
}

/** Weights that are compressed: two states take turns until the bits are used up. */
function readWeights(bytes: Uint8Array): number[] {
  const [table, used] = readFse(bytes, 6, 12);
  const reader = new Backward(bytes.subarray(used));
  const states = [reader.read(table.log), reader.read(table.log)];
  const weights: number[] = [];
  for (let turn = 0; ; turn ^= 1) {
    const state = states[turn]!;
    weights.push(table.symbols[state]!);
    if (weights.length > 254) damaged("a Huffman code has too many weights");
    states[turn] = table.bases[state]! + reader.read(table.bits[state]!);
    if (reader.left < 0) {
      weights.push(table.symbols[states[turn ^ 1]!]!);
      return weights;
    }
  }
}

function decodeLiterals(code: Huffman, bytes: Uint8Array, out: Uint8Array): void {
  const reader = new Backward(bytes);
  for (let i = 0; i < out.length; i++) {
    const index = reader.peek(code.log);
    out[i] = code.symbols[index]!;
    reader.left -= code.bits[index]!;
  }
  if (reader.left !== 0) damaged("a stream of literals has a wrong length");
}

/** What a block leaves to the next one of the same frame. */
class Frame {
  #huffman: Huffman | undefined;
  #tables: Partial<Record<keyof typeof DEFAULTS, Fse>> = {};
  #offsets = [1, 4, 8];
  /** Bytes of `out` that are written. */
  at = 0;

  constructor(readonly out: Uint8Array) {}

  write(bytes: Uint8Array): void {
    if (bytes.length > this.out.length - this.at) damaged("it holds more than expected");
    this.out.set(bytes, this.at);
    this.at += bytes.length;
  }

  repeat(byte: number, count: number): void {
    this.write(new Uint8Array(count).fill(byte));
  }

  block(bytes: Uint8Array): void {
    const [literals, used] = this.#literals(bytes);
    this.#sequences(bytes.subarray(used), literals);
  }

  #literals(bytes: Uint8Array): [Uint8Array, number] {
    const [type, format] = [bytes[0]! & 3, (bytes[0]! >> 2) & 3];
    const header = bytes[0]! + bytes[1]! * 2 ** 8 + bytes[2]! * 2 ** 16;
    if (type < 2) {
      const length = format & 1 ? (format === 1 ? 2 : 3) : 1;
      const size = format === 3 ? Math.floor(header / 16) : format === 1 ? (header % 65536) >> 4 : bytes[0]! >> 3;
      if (!(size <= BLOCK_MAX)) damaged("literals are too long");
      const stored = bytes.subarray(length, length + (type === 0 ? size : 1));
      if (stored.length !== (type === 0 ? size : 1)) damaged("literals are cut off");
      return [type === 0 ? stored : new Uint8Array(size).fill(stored[0]!), length + stored.length];
    }
    const [length, width] = [[3, 10], [3, 10], [4, 14], [5, 18]][format]! as [number, number];
    const all = new Forward(bytes.subarray(0, length));
    all.skip(4);
    const [size, packed] = [all.read(width), all.read(width)];
    if (size > BLOCK_MAX || bytes.length < length + packed) damaged("literals are cut off");
    let rest = bytes.subarray(length, length + packed);
    if (type === 2) {
      const [code, used] = readHuffman(rest);
      this.#huffman = code;
      rest = rest.subarray(used);
    }
    const code = this.#huffman ?? damaged("a Huffman code is missing");
    const literals = new Uint8Array(size);
    if (format === 0) {
      decodeLiterals(code, rest, literals);
    } else {
      const sizes = [0, 2, 4].map((at) => rest[at]! | (rest[at + 1]! << 8));
      const part = (size + 3) >> 2;
      let from = 6;
      for (let i = 0; i < 4; i++) {
        const to = i < 3 ? from + sizes[i]! : rest.length;
        decodeLiterals(code, rest.subarray(from, to), literals.subarray(i * part, i < 3 ? (i + 1) * part : size));
        from = to;
      }
    }
    return [literals, length + packed];
  }

  #sequences(bytes: Uint8Array, literals: Uint8Array): void {
    let count = bytes[0] ?? damaged("the sequences are missing");
    let used = 1;
    if (count >= 128) {
      used = count === 255 ? 3 : 2;
      count = count === 255 ? bytes[1]! + (bytes[2]! << 8) + 0x7f00 : ((count - 128) << 8) + bytes[1]!;
    }
    if (count === 0) return this.write(literals);
    const modes = bytes[used++]!;
    const table = (name: keyof typeof DEFAULTS, mode: number, maxLog: number, maxSymbol: number): Fse => {
      if (mode === 0) this.#tables[name] = DEFAULTS[name];
      if (mode === 1) {
        const symbols = bytes.slice(used, ++used);
        this.#tables[name] = { log: 0, symbols, bits: new Uint8Array(1), bases: new Uint16Array(1) };
      }
      if (mode === 2) {
        const [read, length] = readFse(bytes.subarray(used), maxLog, maxSymbol);
        this.#tables[name] = read;
        used += length;
      }
      return this.#tables[name] ?? damaged("a table is missing");
    };
    const lengths = table("literals", modes >> 6, 9, 35);
    const offsets = table("offsets", (modes >> 4) & 3, 8, 31);
    const matches = table("matches", (modes >> 2) & 3, 9, 52);
    const reader = new Backward(bytes.subarray(used));
    let [length, offset, match] = [reader.read(lengths.log), reader.read(offsets.log), reader.read(matches.log)];
    let from = 0;
    for (let i = 0; i < count; i++) {
      const [lengthCode, offsetCode, matchCode] = [lengths.symbols[length]!, offsets.symbols[offset]!, matches.symbols[match]!];
      const distance = 2 ** offsetCode + reader.read(offsetCode);
      const copied = MATCH_LENGTHS.base[matchCode]! + reader.read(MATCH_LENGTHS.extra[matchCode]!);
      const literal = LITERAL_LENGTHS.base[lengthCode]! + reader.read(LITERAL_LENGTHS.extra[lengthCode]!);
      if (i + 1 < count) {
        length = lengths.bases[length]! + reader.read(lengths.bits[length]!);
        match = matches.bases[match]! + reader.read(matches.bits[match]!);
        offset = offsets.bases[offset]! + reader.read(offsets.bits[offset]!);
      }
      if (reader.left < 0 || from + literal > literals.length) damaged("the sequences are cut off");
      this.write(literals.subarray(from, from + literal));
      from += literal;
      this.#copy(this.#distance(distance, literal), copied);
    }
    if (reader.left !== 0) damaged("the sequences have a wrong length");
    this.write(literals.subarray(from));
  }

  /** The distance that a value stands for: one of the last three, or a new one. */
  #distance(value: number, literal: number): number {
    const last = this.#offsets;
    if (value > 3) {
      this.#offsets = [value - 3, last[0]!, last[1]!];
      return value - 3;
    }
    const index = value - 1 + (literal === 0 ? 1 : 0);
    const distance = index === 3 ? last[0]! - 1 : last[index]!;
    if (index > 0) this.#offsets = [distance, last[0]!, index === 1 ? last[2]! : last[1]!];
    return distance;
  }

  #copy(distance: number, count: number): void {
    const { out, at } = this;
    if (distance < 1 || distance > at || count > out.length - at) damaged("a copy lies outside");
    if (distance >= count) {
      out.copyWithin(at, at - distance, at - distance + count);
    } else {
      for (let i = at; i < at + count; i++) out[i] = out[i - distance]!;
    }
    this.at += count;
  }
}

/**
 * Decompresses one frame that holds `size` bytes; throws if it is damaged or holds another number of bytes. Its checksum is
 * not compared.
 */
export function decompress(bytes: Uint8Array, size: number): Uint8Array {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  if (bytes.length < 6 || view.getUint32(0, true) !== MAGIC) damaged("it has another magic number");
  const descriptor = bytes[4]!;
  const single = (descriptor & 32) !== 0;
  if (descriptor & 3) damaged("it needs a dictionary");
  const sizeBytes = [single ? 1 : 0, 2, 4, 8][descriptor >> 6]!;
  let at = 5 + (single ? 0 : 1) + sizeBytes;
  const out = new Uint8Array(size);
  const frame = new Frame(out);
  for (let last = false; !last; ) {
    if (at + 3 > bytes.length) damaged("it is cut off");
    const header = bytes[at]! | (bytes[at + 1]! << 8) | (bytes[at + 2]! << 16);
    at += 3;
    last = (header & 1) === 1;
    const [type, length] = [(header >> 1) & 3, header >> 3];
    const stored = type === 1 ? 1 : length;
    if (at + stored > bytes.length || length > BLOCK_MAX) damaged("a block is cut off");
    const block = bytes.subarray(at, at + stored);
    at += stored;
    if (type === 0) frame.write(block);
    else if (type === 1) frame.repeat(block[0]!, length);
    else if (type === 2) frame.block(block);
    else damaged("a block has an unknown type");
  }
  if (descriptor & 4) at += 4;
  if (frame.at !== size || at !== bytes.length) damaged("it has a wrong length");
  return out;
}
