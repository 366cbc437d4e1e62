// Pictures into textures, and the display's shader over them.

import { FRAGMENT, VERTEX } from "layerfield/shaders.js";

const LINKS = ["additive", "multiplicative", "polarisation"];
const SHOWN = ["simulated", "target", "difference", "picture"];

export class Stage {
  constructor(canvas) {
    this.canvas = canvas;
    const options = { alpha: false, antialias: false, preserveDrawingBuffer: true };
    this.gl = canvas.getContext("webgl2", options);
    if (!this.gl) throw new Error("This browser offers no WebGL2, which the simulation needs.");
    canvas.addEventListener("webglcontextlost", () => this.lost?.());
    this.gl.pixelStorei(this.gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, this.gl.NONE);
    this.gl.pixelStorei(this.gl.UNPACK_ALIGNMENT, 1);
    this.program = this.compiled();
    this.gl.useProgram(this.program);
    const units = { high: 0, low: 1, decoded: 2, encoded: 3, target: 4 };
    for (const [name, unit] of Object.entries(units)) this.gl.uniform1i(this.place(name), unit);
    this.blank = this.picture(null);
    this.blanks = this.layers([[null]], { width: 1, height: 1 });
  }

  compiled() {
    const { gl } = this;
    const names = [...LINKS, ...SHOWN].map((name) => name.toUpperCase());
    const numbers = [...LINKS.keys(), ...SHOWN.keys()];
    const defines = names.map((name, i) => `#define ${name} ${numbers[i]}\n`).join("");
    const program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text.replace("es\n", `es\n${defines}`));
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS))
      throw new Error(`The shader does not compile here: ${gl.getProgramInfoLog(program)}`);
    return program;
  }

  place(name) {
    return this.gl.getUniformLocation(this.program, name);
  }

  texture(kind) {
    const { gl } = this;
    const texture = gl.createTexture();
    gl.activeTexture(gl.TEXTURE7);
    gl.bindTexture(kind, texture);
    gl.texParameteri(kind, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(kind, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    return texture;
  }

  // All pictures of a result, subframe by subframe, front to back.
  layers(bitmaps, { width, height }) {
    const { gl } = this;
    const kind = gl.TEXTURE_2D_ARRAY, all = bitmaps.flat();
    const texture = this.texture(kind);
    gl.texStorage3D(kind, 1, gl.RGBA8, width, height, all.length);
    all.forEach((bitmap, i) => {
      if (bitmap)
        gl.texSubImage3D(kind, 0, 0, 0, i, width, height, 1, gl.RGBA, gl.UNSIGNED_BYTE, bitmap);
    });
    return texture;
  }

  picture(bitmap) {
    const { gl } = this;
    const texture = this.texture(gl.TEXTURE_2D);
    if (bitmap) gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, bitmap);
    return texture;
  }

  // A table of numbers, in rows of at most `width`.
  table(numbers, width) {
    const { gl } = this;
    const texture = this.texture(gl.TEXTURE_2D);
    const rows = Math.ceil(numbers.length / width);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.R32F, width, rows, 0, gl.RED, gl.FLOAT, numbers);
    return texture;
  }

  forget(textures) {
    textures.forEach((texture) => texture && this.gl.deleteTexture(texture));
  }

  resize(width, height) {
    if (this.canvas.width !== width) this.canvas.width = width;
    if (this.canvas.height !== height) this.canvas.height = height;
  }

  // Draw one picture.
  //   result    with its textures (see loading.js)
  //   what      one of SHOWN
  //   paths     of the eye, see optics.js
  //   target    texture of a view, for "target" and "difference"
  //   picture   number of a picture, for "picture"
  //   column    where on the canvas the picture starts
  //   from, to  columns that are drawn; others stay
  //   mask      which of red, green and blue are drawn
  draw(result, { what, paths, target, picture = 0, column = 0, from, to, mask, gain = 10 }) {
    const { gl } = this;
    const { display, layer, view, textures } = result;
    const size = what === "picture" ? layer : view;
    const bound = [
      [gl.TEXTURE_2D_ARRAY, textures.high],
      [gl.TEXTURE_2D_ARRAY, textures.low ?? this.blanks],
      [gl.TEXTURE_2D, textures.decoded ?? this.blank],
      [gl.TEXTURE_2D, textures.encoded ?? this.blank],
      [gl.TEXTURE_2D, target ?? this.blank],
    ];
    bound.forEach(([kind, texture], unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(kind, texture);
    });
    gl.uniform1i(this.place("deep"), textures.low ? 1 : 0);
    gl.uniform1i(this.place("transfer"), textures.decoded ? 1 : 0);
    gl.uniform1i(this.place("shown"), SHOWN.indexOf(what));
    gl.uniform1i(this.place("link"), LINKS.indexOf(display.link));
    gl.uniform1i(this.place("layers"), display.depths.length);
    gl.uniform1i(this.place("subframes"), display.subframes);
    gl.uniform1i(this.place("picture"), picture);
    gl.uniform1f(this.place("neutral"), display.neutral);
    gl.uniform1f(this.place("gain"), gain);
    gl.uniform2f(this.place("origin"), column, 0);
    gl.uniform2f(this.place("size"), size.width, size.height);
    gl.uniform2f(this.place("margin"), layer.margin[1], layer.margin[0]);
    const numbers = new Float32Array(24);
    paths?.forEach((path, k) => {
      numbers.set([path.magnification, path.x / layer.factor, path.y / layer.factor], 3 * k);
    });
    gl.uniform3fv(this.place("path"), numbers);
    gl.colorMask(...(mask ?? [true, true, true]), true);
    gl.enable(gl.SCISSOR_TEST);
    const left = column + (from ?? 0), right = column + (to ?? size.width);
    gl.scissor(left, 0, Math.max(right - left, 0), size.height);
    gl.viewport(column, 0, size.width, size.height);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.colorMask(true, true, true, true);
  }

  // What is on the canvas: RGBA, the top row first.
  pixels() {
    const { gl } = this;
    const { width, height } = this.canvas;
    const upward = new Uint8Array(4 * width * height), found = new Uint8Array(upward.length);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, upward);
    for (let row = 0; row < height; row++) {
      const start = 4 * width * (height - 1 - row);
      found.set(upward.subarray(start, start + 4 * width), 4 * width * row);
    }
    return { width, height, values: found };
  }
}
