// Decodes a picture's binary message; its layout is in daemon/http/picture_message.py.

const TYPES = { uint8: Uint8Array, uint16: Uint16Array };

/** Header and planes by name; planes are views into the message, not copies. */
export function decodePicture(buffer) {
  const size = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, size)));
  const planes = {};
  for (const { name, type, shape, offset } of header.planes) {
    const count = shape.reduce((a, b) => a * b, 1);
    planes[name] = new TYPES[type](buffer, 4 + size + offset, count);
  }
  return { ...header, planes };
}
