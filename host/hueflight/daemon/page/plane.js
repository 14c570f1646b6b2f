// SPDX-License-Identifier: Apache-2.0
// The flat views: depth, colour, each band, photons.

import { Textures, context, fit, program } from "./gl.js";
import { colourMap, wavelengthColour } from "./colours.js";

const VERTEX = `
out vec2 place;
void main() {
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1);
  place = vec2(corner.x, 1.0 - corner.y);
  gl_Position = vec4(corner * 2.0 - 1.0, 0.0, 1.0);
}`;

const FRAGMENT = `
uniform highp usampler2D depth, photons;
uniform highp sampler2DArray bands;
uniform sampler2D map, colours;
uniform bool three;         // three bands as red, green and blue
uniform int view;           // 0 depth, 1 colour, 2 one band, 3 photons
uniform int band;
uniform ivec3 rgb;
uniform vec2 range;         // in units of the plane
uniform vec3 tint;
uniform ivec2 size;
in vec2 place;
out vec4 colour;
const vec4 NOTHING = vec4(0.075, 0.085, 0.1, 1.0);
void main() {
  ivec2 at = clamp(ivec2(place * vec2(size)), ivec2(0), size - 1);
  if (view == 0 || view == 3) {
    uint value = view == 0 ? texelFetch(depth, at, 0).r : texelFetch(photons, at, 0).r;
    if (value == 65535u && view == 0) { colour = NOTHING; return; }
    float share = clamp((float(value) - range.x) / max(range.y - range.x, 1e-6), 0.0, 1.0);
    colour = texture(map, vec2((share * 255.0 + 0.5) / 256.0, 0.5));
  } else if (view == 1 && !three) {
    colour = texelFetch(colours, at, 0);
  } else if (view == 1) {
    colour = vec4(
      texelFetch(bands, ivec3(at, rgb.r), 0).r, texelFetch(bands, ivec3(at, rgb.g), 0).r,
      texelFetch(bands, ivec3(at, rgb.b), 0).r, 1.0);
  } else {
    float value = texelFetch(bands, ivec3(at, band), 0).r;
    colour = vec4(mix(tint, vec3(1.0), max(value * 2.0 - 1.0, 0.0)) * min(value * 1.6, 1.0), 1.0);
  }
}`;

const VIEWS = { depth: 0, colour: 1, bands: 2, photons: 3 };

export class Plane {
  constructor(canvas) {
    this.canvas = canvas;
    this.gl = context(canvas);
    this.program = program(this.gl, VERTEX, FRAGMENT);
    this.textures = new Textures(this.gl);
    this.textures.map(colourMap());
    this.picture = null;
    this.gl.bindVertexArray(this.gl.createVertexArray());
  }

  show(picture) {
    this.picture = picture;
    this.textures.fill(picture);
  }

  /** Tiles of the band view: [x, y, width, height] as shares of the canvas. */
  static tiles(count) {
    const across = Math.ceil(Math.sqrt(count));
    const down = Math.ceil(count / across);
    return Array.from({ length: count }, (_, i) => [
      (i % across) / across, Math.floor(i / across) / down, 1 / across, 1 / down,
    ]);
  }

  draw({ view, bands, rgb, three, range }) {
    fit(this.canvas);
    const { gl, canvas, picture } = this;
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0.05, 0.06, 0.07, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    if (!picture) return;
    gl.useProgram(this.program.made);
    this.textures.use(this.program);
    const { uniforms } = this.program;
    gl.uniform1i(uniforms.view, VIEWS[view] ?? 0);
    gl.uniform2f(uniforms.range, range[0], range[1]);
    gl.uniform3i(uniforms.rgb, ...rgb);
    gl.uniform1i(uniforms.three, three ? 1 : 0);
    gl.uniform2i(uniforms.size, picture.cols, picture.rows);
    if (view !== "bands") {
      gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
      return;
    }
    const gap = 2;
    Plane.tiles(bands.length).forEach(([x, y, w, h], i) => {
      const [left, top] = [Math.round(x * canvas.width), Math.round(y * canvas.height)];
      const [right, bottom] = [Math.round((x + w) * canvas.width), Math.round((y + h) * canvas.height)];
      gl.viewport(left, canvas.height - bottom, right - left - gap, bottom - top - gap);
      gl.uniform1i(uniforms.band, i);
      gl.uniform3f(uniforms.tint, ...wavelengthColour(bands[i].wavelength_nm));
      gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    });
  }
}
