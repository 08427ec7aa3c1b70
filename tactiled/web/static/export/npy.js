/** A .npy file, numpy's own, read: what the service sends an array as. @module */

/**
 * @param {ArrayBuffer} file
 * @returns {Float32Array} its numbers, row by row
 * @throws {RangeError} where they are anything else
 */
export function npy(file) {
  const start = 10 + new DataView(file).getUint16(8, true); // version 1: the header's length, then the header
  const header = new TextDecoder("latin1").decode(file.slice(10, start));
  if (!header.includes("'<f4'") || !header.includes("'fortran_order': False")) {
    throw new RangeError(`.npy: expected rows of 32-bit numbers, got ${header.trim()}`);
  }
  return new Float32Array(file.slice(start));
}
