// SPDX-License-Identifier: Apache-2.0
// Decodes a picture's binary message; docs/live-pictures.md specifies it.

export const VERSION = 1;
const TYPES = {
  uint8: Uint8Array,
  uint16: Uint16Array,
  uint32: Uint32Array,
  float32: Float32Array,
  float64: Float64Array,
};

/** Header and planes by name; planes are views into the message, not copies. */
export function decodePicture(buffer) {
  const size = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, size)));
  if (header.version !== VERSION) throw new Error(`message of version ${header.version}: reload the page`);
  const planes = {};
  for (const { name, type, shape, offset } of header.planes) {
    const count = shape.reduce((a, b) => a * b, 1);
    planes[name] = new TYPES[type](buffer, 4 + size + offset, count);
  }
  return { ...header, planes };
}
