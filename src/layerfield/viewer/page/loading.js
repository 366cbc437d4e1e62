// Results from the page's description: pictures are fetched when they are first needed.

const KEPT = 40; // targets whose textures are kept

export class Result {
  constructor(stage, description) {
    Object.assign(this, description);
    this.stage = stage;
    this.textures = null;
    this.bitmaps = [];
    this.targetTextures = new Map();
  }

  async load() {
    if (this.textures) return;
    const [high, low] = await Promise.all([this.all(this.pictures), this.all(this.fine)]);
    this.bitmaps = high;
    this.textures = {
      high: this.stage.layers(high, this.layer),
      low: low && this.stage.layers(low, this.layer),
      decoded: this.transfer && this.stage.table(floats(this.transfer.decoded), 256),
      encoded: this.transfer && this.stage.table(floats(this.transfer.encoded), 1024),
    };
  }

  all(pictures) {
    return pictures && Promise.all(pictures.map((row) => Promise.all(row.map(bitmapOf))));
  }

  // The texture of what a viewpoint should see; null where that is not at hand.
  async target(view) {
    if (!this.targets) return null;
    const known = this.targetTextures.get(view);
    if (known) return known;
    const texture = this.stage.picture(await bitmapOf(this.targets[view]));
    this.targetTextures.set(view, texture);
    if (this.targetTextures.size > KEPT) {
      const [oldest, old] = this.targetTextures.entries().next().value;
      this.targetTextures.delete(oldest);
      this.stage.forget([old]);
    }
    return texture;
  }
}

async function bitmapOf(address) {
  const answer = await fetch(address);
  if (!answer.ok) throw new Error(`${address} is gone; is layerfield view still running?`);
  const plain = { colorSpaceConversion: "none", premultiplyAlpha: "none" };
  return createImageBitmap(await answer.blob(), plain);
}

// Numbers written as base64 of little-endian float32.
function floats(text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  return new Float32Array(bytes.buffer);
}
