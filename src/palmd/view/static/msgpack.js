// Decoder for the subset of msgpack that palmd uses: maps with string keys, lists, numbers, booleans, strings, bytes.

const utf8 = new TextDecoder();

/** The value in `bytes` (Uint8Array); lists become arrays, maps objects, bytes views. Throws RangeError for invalid data. */
export function decode(bytes) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  let at = 0;

  function advance(count) {
    const start = at;
    at += count;
    return start;
  }

  function text(length) {
    const start = advance(length);
    if (at > bytes.length) throw new RangeError("text beyond the end");
    if (length > 40) return utf8.decode(bytes.subarray(start, at));
    let found = ""; // faster than a decoder for short names
    for (let i = start; i < at; i++) {
      if (bytes[i] > 0x7f) return utf8.decode(bytes.subarray(start, at));
      found += String.fromCharCode(bytes[i]);
    }
    return found;
  }

  function raw(length) {
    const start = advance(length);
    if (at > bytes.length) throw new RangeError("bytes beyond the end");
    return bytes.subarray(start, at);
  }

  function list(length) {
    const found = [];
    for (let i = 0; i < length; i++) found.push(value());
    return found;
  }

  function map(length) {
    const found = {};
    for (let i = 0; i < length; i++) {
      const key = value();
      found[key] = value();
    }
    return found;
  }

  function value() {
    const tag = view.getUint8(advance(1));
    if (tag < 0x80) return tag;
    if (tag < 0x90) return map(tag & 0x0f);
    if (tag < 0xa0) return list(tag & 0x0f);
    if (tag < 0xc0) return text(tag & 0x1f);
    if (tag >= 0xe0) return tag - 0x100;
    switch (tag) {
      case 0xc0: return null;
      case 0xc2: return false;
      case 0xc3: return true;
      case 0xc4: return raw(view.getUint8(advance(1)));
      case 0xc5: return raw(view.getUint16(advance(2)));
      case 0xc6: return raw(view.getUint32(advance(4)));
      case 0xca: return view.getFloat32(advance(4));
      case 0xcb: return view.getFloat64(advance(8));
      case 0xcc: return view.getUint8(advance(1));
      case 0xcd: return view.getUint16(advance(2));
      case 0xce: return view.getUint32(advance(4));
      case 0xcf: return Number(view.getBigUint64(advance(8)));
      case 0xd0: return view.getInt8(advance(1));
      case 0xd1: return view.getInt16(advance(2));
      case 0xd2: return view.getInt32(advance(4));
      case 0xd3: return Number(view.getBigInt64(advance(8)));
      case 0xd9: return text(view.getUint8(advance(1)));
      case 0xda: return text(view.getUint16(advance(2)));
      case 0xdb: return text(view.getUint32(advance(4)));
      case 0xdc: return list(view.getUint16(advance(2)));
      case 0xdd: return list(view.getUint32(advance(4)));
      case 0xde: return map(view.getUint16(advance(2)));
      case 0xdf: return map(view.getUint32(advance(4)));
      default: throw new RangeError(`no msgpack: 0x${tag.toString(16)}`);
    }
  }

  return value();
}
