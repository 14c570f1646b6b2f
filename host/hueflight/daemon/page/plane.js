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
uniform highp usampler2D depth, depth_std, photons, frames, quality;
uniform highp sampler2DArray bands;
uniform sampler2D map, colours;
uniform bool three;         // three bands as red, green and blue
uniform int view;           // 0 depth, 1 colour, 2 one band, 3 photons
uniform int band;
uniform ivec3 rgb;
uniform vec2 range;         // in units of the plane
uniform bool logarithmic;
uniform float limit;        // standard deviation of depth, in units of its plane, from which on a
                            // pixel fades; 0 for none
uniform uint flags;         // bits of quality that are hatched
uniform float hatch;        // width of the hatching in pixels of the screen
uniform vec3 tint;
uniform ivec2 size;
in vec2 place;
out vec4 colour;
const vec4 NOTHING = vec4(0.075, 0.085, 0.1, 1.0);

// Share of [low, high] at which a value lies.
float position(float value) {
  vec2 ends = range;
  if (logarithmic) {
    float least = max(ends.y * 1e-6, 1e-12);
    ends = log(max(ends, least));
    value = log(max(value, least));
  }
  return clamp((value - ends.x) / max(ends.y - ends.x, 1e-9), 0.0, 1.0);
}

void shade(ivec2 at);

void main() {
  ivec2 at = clamp(ivec2(place * vec2(size)), ivec2(0), size - 1);
  shade(at);
  if (view == 3) return;  // photons are known everywhere
  if (limit > 0.0 && view != 2) {
    // as it is up to half the limit, gone at twice the limit
    float spread = float(texelFetch(depth_std, at, 0).r);
    float known = 1.0 - clamp(log2(max(spread, 1e-6) / limit) * 0.5 + 0.5, 0.0, 1.0);
    colour = mix(NOTHING, colour, known);
  }
  if ((texelFetch(quality, at, 0).r & flags) != 0u) {
    bool line = mod(gl_FragCoord.x + gl_FragCoord.y, 2.0 * hatch) < hatch;
    colour = vec4(mix(colour.rgb, line ? vec3(1.0, 0.36, 0.3) : colour.rgb, 0.75), 1.0);
  }
}

void shade(ivec2 at) {
  if (view == 0 || view == 3) {
    uint value = texelFetch(depth, at, 0).r;
    if (value == 65535u && view == 0) { colour = NOTHING; return; }
    float share = position(view == 0 ? float(value)
      : float(texelFetch(photons, at, 0).r) / max(1.0, float(texelFetch(frames, at, 0).r)));
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
    this.picture = null;
    this.chooseMap("viridis");
    this.gl.bindVertexArray(this.gl.createVertexArray());
  }

  /** Use another colour map, by its name. */
  chooseMap(name) {
    this.textures.map(colourMap(name));
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

  draw({ view, bands, rgb, three, range, logarithmic, limit, flags }) {
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
    gl.uniform1i(uniforms.logarithmic, logarithmic ? 1 : 0);
    gl.uniform1f(uniforms.limit, picture.planes.depth_std ? limit / picture.depth_std_scale : 0);
    gl.uniform1ui(uniforms.flags, flags);
    gl.uniform1f(uniforms.hatch, 3 * (window.devicePixelRatio || 1));
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
