// PSNR over the viewpoints, as a picture to click on, with the eye in it.

import { extent } from "layerfield/optics.js";

const SVG = "http://www.w3.org/2000/svg";
const SIDE = 100; // of the longer axis of the range, in units of the picture
const MOST_NUMBERS = 9; // columns; more leave no room for figures

export class ViewMap {
  constructor(svg, says, goTo) {
    Object.assign(this, { svg, says, goTo });
  }

  show(result) {
    const { display, psnr } = result;
    this.display = display;
    this.box = extent(display);
    const longest = Math.max(...this.box.half) || 1;
    const [rows, columns] = display.grid ?? [1, 1];
    const cell = display.grid ? SIDE / Math.max(rows, columns) : SIDE / 12;
    this.scale = display.grid
      ? (SIDE - cell) / 2 / longest
      : (SIDE / 2 - cell) / longest;
    const width = 2 * this.box.half[0] * this.scale + cell, height = 2 * this.box.half[1] * this.scale + cell;
    this.svg.setAttribute("viewBox", `${-width / 2 - 1} ${-height / 2 - 1} ${width + 2} ${height + 2}`);
    this.svg.style.aspectRatio = `${width + 2} / ${height + 2}`;
    this.svg.replaceChildren();
    const known = (psnr ?? []).filter((value) => value !== null);
    const [worst, best] = [Math.min(...known), Math.max(...known)];
    display.slopes.forEach((slope, view) => {
      const share = known.length ? ((psnr[view] ?? best) - worst) / (best - worst || 1) : null;
      this.svg.append(this.cell(slope, view, cell, psnr?.[view], share, columns));
    });
    this.marker = this.made("circle", { r: cell / 2.6, class: "eye" });
    this.svg.append(this.marker);
    this.says.textContent = known.length
      ? `${worst.toFixed(2)} dB (pale) to ${best.toFixed(2)} dB (dark)`
      : "No figures here: synth --targets keeps what the views should show.";
  }

  cell(slope, view, side, value, share, columns) {
    const [x, y] = this.at(slope);
    const [rows, across] = this.display.grid ?? [1, this.display.slopes.length];
    const name = `view ${Math.floor(view / across)}, ${view % across}`;
    const figure = value === undefined ? "" : value === null ? "exact" : `${value.toFixed(2)} dB`;
    const group = this.made("g", { tabindex: 0, role: "button", "data-view": view });
    const label = figure ? `${name}: ${figure}` : name;
    group.setAttribute("aria-label", label);
    const title = this.made("title", {});
    title.textContent = label;
    const box = this.made("rect", {
      x: x - side / 2, y: y - side / 2, width: side, height: side,
      style: share === null ? "" : `fill: ${shade(share)}`,
    });
    group.append(title, box);
    if (figure && columns <= MOST_NUMBERS && this.display.grid && rows <= MOST_NUMBERS) {
      const text = this.made("text", { x, y: y + side / 9, "font-size": side / 3.4, fill: share > 0.5 ? "#fff" : "#111" });
      text.textContent = value === null ? "∞" : value.toFixed(1);
      group.append(text);
    }
    const go = () => this.goTo(...slope);
    group.addEventListener("click", go);
    group.addEventListener("keydown", (event) => {
      if (event.key !== "Enter") return;
      go();
      event.preventDefault();
    });
    return group;
  }

  at(slope) {
    return slope.map((value, axis) => (value - this.box.centre[axis]) * this.scale);
  }

  mark(slope) {
    const { x, y, width, height } = this.svg.viewBox.baseVal;
    const [across, down] = this.at(slope);
    this.marker.setAttribute("cx", Math.min(Math.max(across, x), x + width));
    this.marker.setAttribute("cy", Math.min(Math.max(down, y), y + height));
  }

  made(kind, attributes) {
    const element = document.createElementNS(SVG, kind);
    for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
    return element;
  }
}

// From pale to dark blue, evenly light to the eye.
function shade(share) {
  const [pale, dark] = [[222, 235, 247], [8, 69, 148]];
  return `rgb(${pale.map((from, i) => Math.round(from + share * (dark[i] - from))).join(" ")})`;
}
