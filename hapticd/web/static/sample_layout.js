// The layout of samples in a batch, from numpy's description of a record: `[name, format]` or `[name, format, [length]]`,
// packed. Aligned little-endian fields, as in all samples of this version, are read through typed arrays, others through a
// DataView at a tenth of the speed.

const FORMAT_READERS = {
  f8: [8, "getFloat64", Float64Array], f4: [4, "getFloat32", Float32Array],
  i8: [8, "getBigInt64", null], u8: [8, "getBigUint64", null], // time_ns: see difference()
  i4: [4, "getInt32", Int32Array], u4: [4, "getUint32", Uint32Array],
  i2: [2, "getInt16", Int16Array], u2: [2, "getUint16", Uint16Array],
  i1: [1, "getInt8", Int8Array], u1: [1, "getUint8", Uint8Array], b1: [1, "getUint8", Uint8Array],
};
const IS_LITTLE_ENDIAN = new Uint8Array(new Uint16Array([1]).buffer)[0] === 1;

// Integers of 64 bits minus `origin`, exact as long as the difference is below 2^53, without making a BigInt of each.
function difference(view, at, stride, count, signed, little, origin, put) {
  const low = Number(BigInt.asUintN(32, origin));
  const high = Number(origin >> 32n);
  for (let i = 0; i < count; i++, at += stride) {
    const upper = at + (little ? 4 : 0);
    const h = signed ? view.getInt32(upper, little) : view.getUint32(upper, little);
    put(i, (h - high) * 4294967296 + (view.getUint32(at + (little ? 0 : 4), little) - low));
  }
}

// The records of one batch.
class Records {
  constructor(layout, data) {
    this.layout = layout;
    this.count = Math.floor(data.byteLength / layout.size);
    const aligned = data.byteOffset % 8 === 0 ? data : data.slice(); // typed arrays need alignment
    this.view = new DataView(aligned.buffer, aligned.byteOffset, aligned.byteLength);
    this.arrays = new Map();
  }

  // Returns a field of the first record as a BigInt.
  integer(name) {
    const field = this.layout.fields.get(name);
    if (field === undefined) {
      return 0n;
    }
    return BigInt(this.view[field.getter](field.at, field.little));
  }

  #array(type) {
    let array = this.arrays.get(type);
    if (array === undefined) {
      array = new type(this.view.buffer, this.view.byteOffset, Math.floor(this.view.byteLength / type.BYTES_PER_ELEMENT));
      this.arrays.set(type, array);
    }
    return array;
  }

  // Copies a component of a field of the records from `skip` on into the ring `column` from index `at` on. The values are
  // NaN (0 in a column of integers) if samples do not have the field.
  copy(name, component, column, at, skip, factor, origin) {
    const field = this.layout.fields.get(name);
    const { size } = this.layout;
    const capacity = column.length;
    const n = this.count - skip;
    if (field === undefined || component >= field.length) {
      for (let i = 0; i < n; i++, at = at + 1 === capacity ? 0 : at + 1) {
        column[at] = NaN;
      }
      return;
    }
    const begin = skip * size + field.at + component * field.width;
    if (field.width === 8 && field.type === null) {
      difference(this.view, begin, size, n, field.signed, field.little, origin, (i, value) => {
        column[(at + i) % capacity] = value * factor;
      });
      return;
    }
    if (field.little === IS_LITTLE_ENDIAN && size % field.width === 0 && begin % field.width === 0) {
      const source = this.#array(field.type);
      const stride = size / field.width;
      for (let i = 0, from = begin / field.width; i < n; i++, from += stride, at = at + 1 === capacity ? 0 : at + 1) {
        column[at] = source[from] * factor;
      }
      return;
    }
    for (let i = 0, from = begin; i < n; i++, from += size, at = at + 1 === capacity ? 0 : at + 1) {
      column[at] = this.view[field.getter](from, field.little) * factor;
    }
  }
}

class Layout {
  fields = new Map();
  size = 0;

  constructor(dtype) {
    for (const [name, format, shape] of dtype) {
      const kind = FORMAT_READERS[format.slice(1)];
      if (kind === undefined || !"<>|".includes(format[0])) {
        throw new Error(`samples: field ${name} has a format that this page cannot read: ${format}`);
      }
      const [width, getter, type] = kind;
      const length = (shape ?? []).reduce((a, b) => a * b, 1);
      const little = format[0] !== ">";
      this.fields.set(name, { at: this.size, width, getter, type, length, little, signed: format[1] === "i" });
      this.size += width * length;
    }
  }

  records(data) {
    return new Records(this, data);
  }
}

const layouts = new Map(); // by description; usually one, and a second one after an update of the daemon

export function layoutOf(dtype) {
  const key = JSON.stringify(dtype);
  let layout = layouts.get(key);
  if (layout === undefined) {
    layout = new Layout(dtype);
    layouts.set(key, layout);
  }
  return layout;
}
