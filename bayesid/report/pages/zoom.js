// Zooms figures over time into a range: buttons, dragging, links to segments. Without it the figures are
// whole and the links lead to them.
"use strict";
(() => {
  const SVG = document.querySelector("svg")?.namespaceURI;
  const make = (name, attributes, parent) => {
    const element = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    parent?.append(element);
    return element;
  };

  // One drawing of a figure: what moves goes into a group that is stretched, inside another that is clipped.
  const panelOf = (svg, name, whole, bands) => {
    const outline = svg.querySelector('[id$="-area"] path').getAttribute("d").match(/-?[\d.]+/g).map(Number);
    const [xs, ys] = [0, 1].map((side) => outline.filter((_, k) => k % 2 === side));
    const box = { x: Math.min(...xs), y: Math.min(...ys) };
    box.width = Math.max(...xs) - box.x;
    box.height = Math.max(...ys) - box.y;
    const still = [...svg.querySelectorAll('[id$="-xaxis"] > g, [id*="-glyph-"]')];
    const clip = make("clipPath", { id: `${name}-clip` }, make("defs", {}, svg));
    make("rect", box, clip);
    const parts = [...svg.querySelectorAll('[id*="-x-"]')].filter((one) => !one.parentElement.closest('[id*="-x-"]'));
    const frame = make("g", { "clip-path": `url(#${name}-clip)` });
    const moving = make("g", { class: "moving" }, frame);
    parts[0].before(frame);
    for (const part of parts) {
      part.querySelectorAll("[clip-path]").forEach((one) => one.removeAttribute("clip-path"));
      moving.append(part);
    }
    const marks = make("g", { class: "marks", hidden: "" }, svg);
    const shade = make("rect", { class: "shade", y: box.y, height: box.height, width: 0 }, svg);
    let range = whole;

    const place = (t) => box.x + ((t - range[0]) / (range[1] - range[0])) * box.width;
    const letter = (x, y, text) => {
      make("text", { x, y, "text-anchor": "middle" }, marks).textContent = text;
    };
    const step = (span) => {
      const most = box.width / 60;
      const power = 10 ** Math.floor(Math.log10(span / most));
      return [1, 2, 5, 10].map((m) => m * power).find((one) => span / one <= most);
    };
    const ticks = () => {
      const every = step(range[1] - range[0]);
      const digits = Math.max(0, Math.ceil(-Math.log10(every) - 1e-9));
      const bottom = box.y + box.height;
      for (let t = Math.ceil(range[0] / every) * every; t <= range[1]; t += every) {
        make("path", { d: `M${place(t)} ${bottom}v4` }, marks);
        letter(place(t), bottom + 14, t.toFixed(digits));
      }
      letter(box.x + box.width / 2, bottom + 28, "time, s");
    };
    const signs = () => {
      for (const [start, end, sign, confidence, ambiguous] of bands) {
        const [a, b] = [place(Math.max(start, range[0])), place(Math.min(end, range[1]))];
        if (b - a < 9) continue;
        const glyph = (sign > 0 ? "+" : "\u2212") + (ambiguous ? "?" : "");
        letter((a + b) / 2, box.y - 4, b - a > 42 ? `${glyph} ${confidence.toFixed(2)}` : glyph);
      }
    };
    return {
      svg,
      shade,
      time: (event) => {
        const { x } = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
        return [x, range[0] + ((x - box.x) / box.width) * (range[1] - range[0])];
      },
      show: (from, to) => {
        range = [from, to];
        const zoomed = to - from < (whole[1] - whole[0]) * 0.999;
        const scale = (whole[1] - whole[0]) / (to - from);
        const shift = box.x * (1 - scale) - ((from - whole[0]) / (whole[1] - whole[0])) * box.width * scale;
        moving.setAttribute("transform", zoomed ? `matrix(${scale} 0 0 1 ${shift} 0)` : "");
        still.forEach((one) => one.toggleAttribute("hidden", zoomed));
        marks.toggleAttribute("hidden", !zoomed);
        marks.replaceChildren();
        if (!zoomed) return;
        ticks();
        signs();
      },
    };
  };

  const enhance = (figure) => {
    const whole = [Number(figure.dataset.left), Number(figure.dataset.right)];
    const bands = JSON.parse(figure.dataset.bands);
    const panels = [...figure.querySelectorAll("svg")].map((svg, k) => panelOf(svg, `${figure.id}-${k}`, whole, bands));
    let range = whole;

    const extent = document.createElement("output");
    const show = (from, to) => {
      const [all, least] = [whole[1] - whole[0], (whole[1] - whole[0]) / 2000];
      const span = Math.min(Math.max(to - from, least), all);
      const start = Math.min(Math.max(from, whole[0]), whole[1] - span);
      range = [start, start + span];
      panels.forEach((panel) => panel.show(...range));
      extent.textContent = span < all * 0.999 ? `${range[0].toFixed(2)} to ${range[1].toFixed(2)} s` : "";
    };
    const about = (factor, shift = 0) => {
      const [middle, half] = [(range[0] + range[1]) / 2, (range[1] - range[0]) / 2];
      show(middle + 2 * half * shift - half * factor, middle + 2 * half * shift + half * factor);
    };
    const actions = [
      ["\u2212", "Zoom out", () => about(2)],
      ["+", "Zoom in", () => about(0.5)],
      ["\u2190", "Earlier", () => about(1, -0.5)],
      ["\u2192", "Later", () => about(1, 0.5)],
      ["All", "Show all", () => show(...whole)],
    ];
    const controls = document.createElement("div");
    controls.className = "controls";
    for (const [text, label, act] of actions) {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = text;
      button.setAttribute("aria-label", `${label}: ${figure.querySelector("figcaption").textContent}`);
      button.addEventListener("click", act);
      controls.append(button);
    }
    controls.append(extent);
    figure.prepend(controls);

    for (const panel of panels) {
      let from = null;
      panel.svg.addEventListener("pointerdown", (event) => {
        if (event.pointerType !== "mouse" || event.button !== 0) return; // a finger scrolls the page
        from = panel.time(event);
        panel.svg.setPointerCapture(event.pointerId);
      });
      panel.svg.addEventListener("pointermove", (event) => {
        if (!from) return;
        const [x] = panel.time(event);
        panel.shade.setAttribute("x", Math.min(x, from[0]));
        panel.shade.setAttribute("width", Math.abs(x - from[0]));
      });
      panel.svg.addEventListener("pointerup", (event) => {
        if (!from) return;
        const [[x, t], [x0, t0]] = [panel.time(event), from];
        from = null;
        panel.shade.setAttribute("width", 0);
        if (Math.abs(x - x0) > 3) show(Math.min(t, t0), Math.max(t, t0));
      });
      panel.svg.addEventListener("dblclick", () => show(...whole));
    }
    return show;
  };

  const shows = new Map();
  for (const figure of document.querySelectorAll("figure.wide")) {
    shows.set(figure.id, enhance(figure));
  }
  document.addEventListener("click", (event) => {
    const link = event.target.closest("a[data-from]");
    const show = link && shows.get(link.hash.slice(1));
    if (!show) return;
    const [from, to] = [Number(link.dataset.from), Number(link.dataset.to)];
    const margin = Math.max(2 * (to - from), 0.2);
    show(from - margin, to + margin);
  });
})();
