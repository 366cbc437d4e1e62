// The page: what is shown, by whom it is changed, and when it is drawn again.

import { Eye } from "layerfield/eye.js";
import { Result } from "layerfield/loading.js";
import { ViewMap } from "layerfield/map.js";
import { nearestView, paths } from "layerfield/optics.js";
import { drawStack } from "layerfield/stack.js";
import { Stage } from "layerfield/stage.js";

const MODES = {
  simulated: "What the eye sees",
  beside: "Beside the target",
  split: "Split",
  difference: "Difference",
  layer: "Layers",
  stack: "The stack",
  anaglyph: "Red-cyan",
  pair: "Two eyes",
};
const NEEDS_TARGET = ["beside", "split", "difference"];
const TWO_EYES = ["anaglyph", "pair"];
const TALLEST = 74; // of a picture, in hundredths of the height of the window
const FULL_COLOUR = 0.1; // difference of values that gets the strongest colour

const $ = (id) => document.getElementById(id);

class Page {
  constructor({ results }) {
    this.stage = new Stage($("stage"));
    this.stage.lost = () => trouble(new Error("The graphics were reset; load the page again."));
    this.results = results.map((description) => new Result(this.stage, description));
    this.eye = new Eye(() => (this.stale = true));
    this.map = new ViewMap($("map"), $("map-says"), (x, y) => this.eye.goTo(x, y));
    this.mode = "simulated";
    this.divider = 0.5;
    this.layer = 0;
    this.subframe = 0;
    choices($("results"), this.results.map((result) => result.title), (i) => this.choose(i));
    choices($("modes"), Object.values(MODES), (i) => this.show(Object.keys(MODES)[i]));
    this.listen();
  }

  async choose(index) {
    const result = this.results[index];
    await result.load();
    this.result = result;
    if (NEEDS_TARGET.includes(this.mode) && !result.targets) this.mode = "simulated";
    this.layer = Math.min(this.layer, result.display.depths.length - 1);
    this.subframe = Math.min(this.subframe, result.display.subframes - 1);
    this.eye.face(result.display);
    this.map.show(result);
    figures($("figures"), this.results, index, (i) => this.choose(i));
    $("notes").replaceChildren(...result.notes.map((note) => element("li", note)));
    $("results").hidden = this.results.length === 1;
    pressed($("results"), index);
    this.show(this.mode);
  }

  show(mode) {
    this.mode = mode;
    pressed($("modes"), Object.keys(MODES).indexOf(mode));
    Object.keys(MODES).forEach((name, i) => {
      const missing = NEEDS_TARGET.includes(name) && !this.result.targets;
      $("modes").children[i].disabled = missing;
      $("modes").children[i].title = missing ? "needs what the views should show: synth --targets" : "";
    });
    $("stage").hidden = mode === "stack";
    $("stack").hidden = mode !== "stack";
    $("divider").hidden = mode !== "split";
    $("scale").hidden = mode !== "difference";
    $("picture").hidden = mode !== "layer" && mode !== "stack";
    $("apart-label").hidden = !TWO_EYES.includes(mode);
    this.stale = true;
  }

  listen() {
    this.eye.listenTo($("stage"));
    this.eye.listenTo($("stack"));
    const moved = () => {
      this.eye.still();
      this.eye.moveTo(+$("across").value, +$("down").value, $("near").value * this.eye.nearness.most);
    };
    for (const name of ["across", "down", "near"]) $(name).addEventListener("input", moved);
    $("apart").addEventListener("input", () => this.set({}, () => (this.eye.apart = +$("apart").value)));
    for (const name of ["layer", "subframe"])
      $(name).addEventListener("input", () => this.set({ [name]: +$(name).value }));
    $("centre").addEventListener("click", () => this.eye.home());
    $("sway").addEventListener("click", () => this.eye.sway(!this.eye.swaying));
    addEventListener("keydown", (event) => this.key(event));
    addEventListener("resize", () => (this.stale = true));
    this.dragDivider();
  }

  set(values, also) {
    Object.assign(this, values);
    also?.();
    this.stale = true;
  }

  key(event) {
    const { key, target } = event;
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const typing = target.matches("input, summary") || (key === " " && target.matches("button"));
    if (typing && key !== "?") return;
    if (this.eye.key(event) || this.letter(key)) event.preventDefault();
  }

  letter(key) {
    const modes = Object.keys(MODES).filter((_, i) => !$("modes").children[i].disabled);
    const next = (values, now, step) => values.at((values.indexOf(now) + step) % values.length);
    const { results, result } = this;
    const layers = [...result.display.depths.keys()];
    const actions = {
      m: () => this.show(next(modes, this.mode, 1)),
      M: () => this.show(next(modes, this.mode, -1)),
      r: () => this.choose(results.indexOf(next(results, result, 1))),
      R: () => this.choose(results.indexOf(next(results, result, -1))),
      l: () => this.set({ layer: next(layers, this.layer, 1) }),
      L: () => this.set({ layer: next(layers, this.layer, -1) }),
      "[": () => this.divide(this.divider - 0.05),
      "]": () => this.divide(this.divider + 0.05),
      "?": () => ($("help").open = !$("help").open),
    };
    actions[key]?.();
    return key in actions;
  }

  divide(share) {
    this.set({ divider: Math.min(Math.max(share, 0), 1) });
    $("divider").setAttribute("aria-valuenow", Math.round(100 * this.divider));
  }

  dragDivider() {
    const handle = $("divider");
    handle.addEventListener("pointerdown", (event) => handle.setPointerCapture(event.pointerId));
    handle.addEventListener("pointermove", (event) => {
      if (!handle.hasPointerCapture(event.pointerId)) return;
      const { left, width } = $("stage").getBoundingClientRect();
      this.divide((event.clientX - left) / width);
    });
    handle.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: -0.02, ArrowRight: 0.02 }[event.key];
      if (!step) return;
      this.divide(this.divider + step);
      event.stopPropagation();
      event.preventDefault();
    });
  }

  async draw() {
    const { result, stage, mode, eye } = this;
    const { view, layer, display } = result;
    const compared = NEEDS_TARGET.includes(mode);
    const number = nearestView(display, eye.slope);
    const slope = compared ? display.slopes[number] : eye.slope;
    const distance = compared ? display.distance ?? Infinity : eye.distance;
    const target = compared ? await result.target(number) : null;
    if (result !== this.result || mode !== this.mode) return;
    const seenFrom = (x) => paths(display, [x, slope[1]], distance);
    const here = { what: "simulated", paths: seenFrom(slope[0]) };
    const wide = mode === "beside" || mode === "pair";
    const size = mode === "layer" ? layer : view;
    const across = wide ? 2 * size.width : size.width;
    stage.resize(across, size.height);
    const fitting = `min(100%, ${((TALLEST * across) / size.height).toFixed(2)}vh)`;
    $("frame").style.width = mode === "stack" ? "100%" : fitting;
    const [left, right] = [slope[0] - eye.apart / 2, slope[0] + eye.apart / 2].map(seenFrom);
    const split = Math.round(this.divider * size.width);
    const draws = {
      simulated: [here],
      beside: [here, { what: "target", target, column: size.width }],
      split: [{ ...here, to: split }, { what: "target", target, from: split }],
      difference: [{ ...here, what: "difference", target, gain: 1 / FULL_COLOUR }],
      layer: [{ what: "picture", picture: this.subframe * display.depths.length + this.layer }],
      stack: [],
      anaglyph: [
        { ...here, paths: left, mask: [true, false, false] },
        { ...here, paths: right, mask: [false, true, true] },
      ],
      pair: [{ ...here, paths: left }, { ...here, paths: right, column: size.width }],
    };
    draws[mode].forEach((draw) => stage.draw(result, draw));
    if (mode === "stack") drawStack($("stack"), result, eye, this.layer);
    this.say(number);
  }

  say(number) {
    const { display, psnr } = this.result;
    const { eye } = this;
    this.map.mark(eye.slope);
    for (const [axis, name] of ["across", "down"].entries()) {
      range($(name), eye.centre[axis] - 1.5 * eye.half[axis], eye.centre[axis] + 1.5 * eye.half[axis], eye.slope[axis]);
      $(`${name}-says`).textContent = position(display, eye.slope[axis] - eye.centre[axis], axis);
    }
    range($("near"), 0, 1, eye.inverse / eye.nearness.most);
    $("near-says").textContent = far(display, eye.distance);
    range($("apart"), 0, eye.widest, eye.apart);
    $("apart-says").textContent = separation(display, eye.apart);
    range($("layer"), 0, display.depths.length - 1, this.layer);
    $("layer-says").textContent = `${this.layer}${this.layer ? "" : " (nearest)"}`;
    range($("subframe"), 0, display.subframes - 1, this.subframe);
    $("subframe-says").textContent = this.subframe;
    $("subframe-label").hidden = display.subframes === 1;
    $("layer").closest("label").hidden = display.depths.length === 1;
    $("sway").setAttribute("aria-pressed", eye.swaying);
    $("divider").style.left = `${100 * this.divider}%`;
    $("caption").textContent = this.caption(number, psnr?.[number]);
  }

  caption(number, psnr) {
    const { display } = this.result;
    const columns = display.grid?.[1] ?? display.slopes.length;
    const name = `view ${Math.floor(number / columns)}, ${number % columns}`;
    const figure = psnr == null ? "" : `: ${psnr.toFixed(2)} dB`;
    return {
      simulated: "What the eye sees of the layers, composed for this place",
      beside: `Simulated and target, ${name}, nearest to the eye${figure}`,
      split: `Simulated on the left, target on the right, ${name}${figure}`,
      difference: `Simulated minus target, ${name}${figure}; full colour at ±${FULL_COLOUR}`,
      layer: `Layer ${this.layer} as its picture file holds it`,
      stack: "The stack, drawn apart",
      anaglyph: "For red-cyan glasses: the left eye in red",
      pair: "For parallel viewing: what the left and the right eye see",
    }[this.mode];
  }

  async frame(milliseconds) {
    this.eye.tick(milliseconds / 1000);
    if (this.stale) {
      this.stale = false;
      await this.draw();
    }
    requestAnimationFrame((now) => this.frame(now).catch(trouble));
  }
}

function choices(box, titles, chosen) {
  box.replaceChildren(
    ...titles.map((title, i) => {
      const button = element("button", title);
      button.type = "button";
      button.setAttribute("role", "radio");
      button.addEventListener("click", () => Promise.resolve(chosen(i)).catch(trouble));
      return button;
    }),
  );
}

function pressed(box, index) {
  [...box.children].forEach((button, i) => button.setAttribute("aria-checked", i === index));
}

function figures(table, results, current, chosen) {
  const names = [...new Set(results.flatMap((result) => Object.keys(result.figures)))];
  const head = element("tr", "");
  head.append(...["result", ...names].map((name) => element("th", name)));
  const rows = results.map((result, i) => {
    const row = element("tr", "");
    const cells = names.map((name) => element("td", result.figures[name] ?? ""));
    row.append(element("th", result.title), ...cells);
    row.addEventListener("click", () => Promise.resolve(chosen(i)).catch(trouble));
    row.setAttribute("aria-current", i === current);
    return row;
  });
  table.replaceChildren(head, ...rows);
}

function range(input, min, max, value) {
  Object.assign(input, { min, max });
  input.value = value;
}

// How far from the centre, in view steps where there is a grid of viewpoints, else in degrees.
function position(display, slope, axis) {
  if (display.step) return `${signed(slope / display.step[axis], 2)} views`;
  return `${signed((Math.atan(slope) * 180) / Math.PI, 1)}°`;
}

function separation(display, slope) {
  if (display.physical && display.distance) return `${(1000 * slope * display.distance).toFixed(0)} mm`;
  return position(display, slope, 0).replace("+", "");
}

function signed(value, digits) {
  const text = value.toFixed(digits);
  return value > 0 ? `+${text}` : text.replace("-", "−");
}

function far(display, distance) {
  if (distance > 1e6) return "∞";
  return display.physical ? `${(1000 * distance).toFixed(0)} mm` : `${distance.toFixed(0)} px`;
}

function element(kind, text) {
  const made = document.createElement(kind);
  made.textContent = text;
  return made;
}

function trouble(error) {
  $("trouble").hidden = false;
  $("trouble").textContent = error.message;
  console.error(error);
}

async function begin() {
  const page = new Page(JSON.parse($("exhibit").textContent));
  await page.choose(0);
  // For scripts: go somewhere and read what is shown there.
  window.layerfield = {
    page,
    async look([x, y], distance = null) {
      page.eye.goTo(x, y);
      page.eye.inverse = distance === null ? page.eye.nearness.usual : 1 / distance;
      await page.draw();
      return page.stage.pixels();
    },
  };
  document.body.dataset.ready = "yes";
  requestAnimationFrame((now) => page.frame(now).catch(trouble));
}

begin().catch(trouble);
