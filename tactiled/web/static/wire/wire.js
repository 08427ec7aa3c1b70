/** The stream's binary messages: one image each, a 64-byte header and then its pressures. @module */

export const RAW = 0;
export const RESTORED = 1;
export const SHEAR = 2;
export const TRACTION = 3;
export const KIND_NAMES = ["raw", "restored", "shear", "traction"];
export const HEADER_BYTES = 64;

/** The kinds of pressure, which every sensor has. @type {number[]} */
export const PRESSURES = [RAW, RESTORED];

/** @param {{shear: boolean, traction: boolean}} sensor @returns {number[]} the kinds of image that it has */
export const kindsOf = ({ shear, traction }) => [...PRESSURES, ...(shear ? [SHEAR] : []), ...(traction ? [TRACTION] : [])];

/** Flags of a raw taxel. */
export const MISSING = 1;
export const BAD = 2;
export const DEAD = 4;
export const SATURATED = 8;
export const OUT_OF_RANGE = 16;
export const FAULTY = 32;
export const BELOW_ZERO = 64;

/** Methods by their number in a message; "" any other. */
export const METHODS = ["", "idle", "raw", "wiener", "rl", "rl-fast", "nnls", "tv", "points", "learned"];

const MAGIC = 0x4c544354; // "TCTL" read as a little-endian word
const VERSION = 1;
const NONE = new Float32Array(0);
const NO_BYTES = new Uint8Array(0);

/**
 * One decoded message. The arrays are views of the packet's own bytes, which the next message replaces: a view of each
 * message would be garbage.
 * @typedef {object} Packet
 * @property {number} kind RAW, RESTORED, SHEAR or TRACTION
 * @property {number} rows 1 for a layout that is no grid
 * @property {number} columns
 * @property {number} sequence
 * @property {number} timestamp Unix time, s, of the frame's first bus message
 * @property {number} sent Unix time, s, at which the service sent this
 * @property {number} noise in `unit`
 * @property {number} unit of pressures, index in UNITS
 * @property {number} noiseGain
 * @property {number} resolutionMm
 * @property {number} microseconds
 * @property {number} iterations
 * @property {number} method index in METHODS
 * @property {Float32Array} values pressures in `unit`, rows * columns; NaN without data; of SHEAR and TRACTION empty
 * @property {Float32Array} shear of SHEAR counts, of TRACTION kPa along x, rows * columns, and then along y; else empty
 * @property {Uint8Array|null} flags one per taxel in a raw image, else null
 * @property {Uint8Array} bytes the whole message
 * @property {DataView} view of it
 * @property {number} nameAt where the sensor's name begins in it
 * @property {number} nameBytes 0 on a stream of one sensor
 */

/** @returns {Packet} an empty packet for `parse` to fill */
export function packet() {
  return {
    kind: RAW, rows: 0, columns: 0, sequence: 0, timestamp: NaN, sent: NaN, unit: 0, noise: NaN, noiseGain: NaN,
    resolutionMm: NaN, microseconds: NaN, iterations: 0, method: 0, values: NONE, shear: NONE, flags: null,
    bytes: NO_BYTES, view: new DataView(NO_BYTES.buffer), nameAt: 0, nameBytes: 0,
  };
}

/** @param {Uint8Array} bytes a message @returns {number} RAW, RESTORED, SHEAR, TRACTION or an unknown kind */
export const kindOf = (bytes) => bytes[5];

/** @param {number} kind @returns {number} values of a cell */
const axesOf = (kind) => (kind >= SHEAR ? 2 : 1);

/** @param {Uint8Array} bytes that begin with a message @returns {number} bytes of the message */
export function messageBytes(bytes) {
  if (bytes.length < HEADER_BYTES) throw new RangeError(`image of ${bytes.length} bytes has no header`);
  const view = new DataView(bytes.buffer, bytes.byteOffset);
  const values = view.getUint16(6, true) * view.getUint16(8, true) * axesOf(kindOf(bytes));
  return HEADER_BYTES + 4 * values + view.getUint16(10, true) + view.getUint16(12, true);
}

/**
 * Take a message apart.
 * @param {Uint8Array} bytes
 * @param {Packet} into filled and returned, so that the caller may use one packet 
 * @returns {Packet}
 * @throws {RangeError} where the message is not one of ours
 */
export function parse(bytes, into) {
  if (bytes.length < HEADER_BYTES) throw new RangeError(`image of ${bytes.length} bytes has no header`);
  const resized = bytes.length !== into.bytes.length;
  if (resized) {
    into.bytes = new Uint8Array(bytes.length);
    into.view = new DataView(into.bytes.buffer);
  }
  into.bytes.set(bytes);
  const { view } = into;
  if (view.getUint32(0, true) !== MAGIC) throw new RangeError("image does not start with TCTL");
  const version = view.getUint8(4);
  if (version !== VERSION) throw new RangeError(`image format is version ${version}, this page reads ${VERSION}`);
  into.kind = view.getUint8(5);
  into.rows = view.getUint16(6, true);
  into.columns = view.getUint16(8, true);
  const flagsBytes = view.getUint16(10, true);
  into.unit = view.getUint16(14, true);
  into.sequence = view.getUint32(16, true) + view.getUint32(20, true) * 2 ** 32;
  into.timestamp = view.getFloat64(24, true);
  into.sent = view.getFloat64(32, true);
  into.noise = view.getFloat32(40, true);
  into.noiseGain = view.getFloat32(44, true);
  into.resolutionMm = view.getFloat32(48, true);
  into.microseconds = view.getFloat32(52, true);
  into.iterations = view.getUint32(56, true);
  into.method = view.getUint32(60, true);
  const count = into.rows * into.columns * axesOf(into.kind);
  into.nameAt = HEADER_BYTES + 4 * count + flagsBytes;
  into.nameBytes = view.getUint16(12, true);
  if (bytes.length < into.nameAt + into.nameBytes) {
    throw new RangeError(`image of ${into.rows} x ${into.columns} ends after ${bytes.length} bytes`);
  }
  const values = into.kind >= SHEAR ? into.shear : into.values;
  const flagged = into.flags ? into.flags.length : 0;
  if (resized || values.length !== count || flagged !== flagsBytes) makeViews(into, count, flagsBytes);
  return into;
}

/**
 * View a packet's bytes again.
 * @param {Packet} into
 * @param {number} count of values
 * @param {number} flagged bytes of flags
 */
function makeViews(into, count, flagged) {
  const { buffer } = into.bytes;
  const values = new Float32Array(buffer, HEADER_BYTES, count);
  into.values = into.kind >= SHEAR ? NONE : values;
  into.shear = into.kind >= SHEAR ? values : NONE;
  into.flags = flagged ? new Uint8Array(buffer, HEADER_BYTES + 4 * count, flagged) : null;
}

/**
 * Whether an image is of the sensor whose name is these bytes.
 * @param {Packet} image
 * @param {Uint8Array} name
 * @returns {boolean}
 */
export function isOf({ view, nameAt, nameBytes }, name) {
  if (nameBytes !== name.length) return false;
  for (let i = 0; i < nameBytes; i += 1) if (view.getUint8(nameAt + i) !== name[i]) return false;
  return true;
}
