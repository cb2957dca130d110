// Draws the figures of a page with uPlot, from the data that each element of class "plot" holds
// (bayesid/report/plot/figure.py defines them). Figures of one group share the range of their x axes, which
// buttons, dragging and links to segments change. For print they are drawn again, dark on white.
"use strict";
(() => {
  const GREY = "#767676"; // replaced by the page's text colour
  const FONT = "12px system-ui, sans-serif";
  const FEW = 300; // dots that lie above lines; more lie below
  const RATIO = uPlot.pxRatio;
  const DASHES = { solid: [], dashed: [6, 4], dotted: [1.5, 3] };
  const plots = [];
  const groups = new Map();
  let ink, lines;

  const look = (paper) => {
    const style = getComputedStyle(document.documentElement);
    [ink, lines] = paper ? ["#444444", "#dddddd"] : ["--soft", "--line"].map((name) => style.getPropertyValue(name));
  };
  const colour = (name) => (name === GREY ? ink : name);
  const element = (tag, className, parent, text = "") => {
    const made = document.createElement(tag);
    made.className = className;
    made.textContent = text;
    parent.append(made);
    return made;
  };
  const minus = (text) => text.replace(/-/g, "\u2212");
  const short = (value) => minus(String(Number(value.toPrecision(4))));

  // ------------------------------------------------------------------------------------------------------------
  // Marks
  // ------------------------------------------------------------------------------------------------------------
  const ends = (u, scale, pair, k) =>
    pair
      ? [u.valToPos(pair[0][k], scale, true), u.valToPos(pair[1][k], scale, true)]
      : scale === "x"
        ? [u.bbox.left, u.bbox.left + u.bbox.width]
        : [u.bbox.top, u.bbox.top + u.bbox.height];
  const count = (mark) => (mark.x ?? mark.y)[0].length;
  const stroke = (u, mark, width) => {
    u.ctx.strokeStyle = colour(mark.colour);
    u.ctx.lineWidth = width * RATIO;
    u.ctx.setLineDash((DASHES[mark.style] ?? []).map((part) => part * RATIO));
  };
  const trace = (u, xs, ys, start) => {
    let up = start;
    xs.forEach((x, k) => {
      if (ys[k] === null || x === null) {
        up = true;
        return;
      }
      u.ctx[up ? "moveTo" : "lineTo"](u.valToPos(x, "x", true), u.valToPos(ys[k], "y", true));
      up = false;
    });
  };
  const hatch = (u, x, y, width, height) => {
    const { ctx } = u;
    ctx.save();
    ctx.beginPath();
    ctx.rect(x, y, width, height);
    ctx.clip();
    ctx.globalAlpha = 0.5;
    ctx.strokeStyle = ink;
    ctx.lineWidth = RATIO;
    ctx.beginPath();
    const step = 7 * RATIO;
    const across = x + width + height;
    for (let at = Math.floor(x / step) * step; at < across; at += step) {
      ctx.moveTo(at, y);
      ctx.lineTo(at - height, y + height);
    }
    ctx.stroke();
    ctx.restore();
  };
  const letter = (u, mark, k, left, right) => {
    const { ctx } = u;
    const [a, b] = [Math.max(left, u.bbox.left), Math.min(right, u.bbox.left + u.bbox.width)];
    if (b - a < 10 * RATIO) return;
    const wide = b - a > 48 * RATIO;
    ctx.fillStyle = ink;
    ctx.textAlign = "center";
    ctx.textBaseline = "bottom";
    ctx.fillText(wide ? `${mark.letters[k]} ${mark.details[k]}` : mark.letters[k], (a + b) / 2, u.bbox.top - RATIO);
  };
  const draw = {
    boxes: (u, mark, panel) => {
      for (let k = 0; k < count(mark); k++) {
        const [[a, b], [c, d]] = [ends(u, "x", mark.x, k), ends(u, "y", mark.y, k)];
        const box = [Math.min(a, b), Math.min(c, d), Math.abs(b - a), Math.abs(d - c)];
        u.ctx.fillStyle = colour(Array.isArray(mark.colour) ? mark.colour[k] : mark.colour);
        u.ctx.globalAlpha = Array.isArray(mark.alpha) ? mark.alpha[k] : mark.alpha;
        if (mark.hatched) hatch(u, ...box);
        else u.ctx.fillRect(...box);
      }
    },
    band: (u, mark, panel) => {
      const xs = panel.xs[mark.x];
      u.ctx.beginPath();
      trace(u, xs, mark.low, true);
      trace(u, [...xs].reverse(), [...mark.high].reverse(), false);
      u.ctx.closePath();
      u.ctx.fillStyle = colour(mark.colour);
      u.ctx.globalAlpha = mark.alpha;
      u.ctx.fill();
    },
    line: (u, mark, panel) => {
      u.ctx.beginPath();
      trace(u, panel.xs[mark.x], mark.y, true);
      stroke(u, mark, mark.width);
      u.ctx.globalAlpha = mark.alpha;
      u.ctx.stroke();
    },
    strokes: (u, mark) => {
      u.ctx.beginPath();
      for (let k = 0; k < count(mark); k++) {
        const [[a, b], [c, d]] = [ends(u, "x", mark.x, k), ends(u, "y", mark.y, k)];
        u.ctx.moveTo(a, c);
        u.ctx.lineTo(b, d);
      }
      stroke(u, mark, mark.width);
      u.ctx.stroke();
    },
    dots: (u, mark) => {
      u.ctx.fillStyle = colour(mark.colour);
      u.ctx.globalAlpha = mark.alpha;
      const radius = 0.75 * mark.size * RATIO;
      mark.x.forEach((x, k) => {
        u.ctx.beginPath();
        u.ctx.arc(u.valToPos(x, "x", true), u.valToPos(mark.y[k], "y", true), radius, 0, 2 * Math.PI);
        u.ctx.fill();
      });
    },
    words: (u, mark) => {
      u.ctx.fillStyle = ink;
      u.ctx.textAlign = "left";
      u.ctx.textBaseline = "middle";
      mark.x.forEach((x, k) => {
        const most = u.bbox.left + u.bbox.width - u.ctx.measureText(mark.texts[k]).width;
        const at = Math.min(u.valToPos(x, "x", true) + 5 * RATIO, most);
        u.ctx.fillText(minus(mark.texts[k]), at, u.valToPos(mark.y[k], "y", true));
      });
    },
  };
  const layer = (panel, chosen, free) => (u) => {
    const { ctx, bbox } = u;
    for (const mark of panel.marks.filter(chosen)) {
      ctx.save();
      if (!free) {
        ctx.beginPath();
        ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
        ctx.clip();
      }
      ctx.font = FONT.replace("12", 12 * RATIO);
      if (free) for (let k = 0; k < count(mark); k++) letter(u, mark, k, ...ends(u, "x", mark.x, k));
      else draw[mark.kind](u, mark, panel);
      ctx.restore();
    }
  };

  // ------------------------------------------------------------------------------------------------------------
  // Panels
  // ------------------------------------------------------------------------------------------------------------
  const under = (mark) => ["boxes", "band"].includes(mark.kind) || (mark.kind === "dots" && mark.x.length > FEW);
  const numbers = (u, places, _, __, step) => {
    const large = Math.max(...places.map(Math.abs));
    if (large >= 1e5 || (large > 0 && large < 1e-3)) return places.map((place) => minus(place.toExponential(1)));
    const digits = Math.max(0, Math.min(6, Math.ceil(-Math.log10(step) - 1e-9)));
    const exact = Math.abs(step * 10 ** digits - Math.round(step * 10 ** digits)) < 1e-6 ? digits : digits + 1;
    return places.map((place) => minus(place.toFixed(exact)));
  };
  const folded = (text, room) => {
    const rows = [""];
    for (const word of text.split(" ")) {
      const last = rows.at(-1);
      if (last && last.length + word.length + 1 > room) rows.push(word);
      else rows[rows.length - 1] = last ? `${last} ${word}` : word;
    }
    return rows.join("\n");
  };
  const measured = (u, values) => {
    u.ctx.font = FONT.replace("12", 12 * RATIO);
    const parts = (values ?? []).flatMap((text) => String(text).split("\n"));
    return 14 + Math.max(32, ...parts.map((text) => u.ctx.measureText(text).width)) / RATIO;
  };
  const axis = (side, width) => ({
    stroke: () => ink,
    font: FONT,
    labelFont: FONT,
    label: side.name || null,
    labelSize: side.name ? 17 : 0,
    labelGap: 0,
    grid: { stroke: () => lines, width: 1, show: side.grid },
    ticks: { stroke: () => ink, width: 1, size: 4, show: !side.ticks || side.ticks[0].length > 0 },
    border: { show: true, stroke: () => ink, width: 1 },
    gap: 3,
    ...(side.ticks
      ? { splits: () => side.ticks[0], values: () => side.ticks[1].map((text) => folded(text, width / 18)) }
      : { values: numbers }),
  });
  const labelled = (name, value) => {
    const [what, unit] = name.split(", ");
    return `${what} ${short(value)} ${unit ?? ""}`;
  };
  const pointed = (u, panel, drawn) => {
    const { left, top, idx } = u.cursor;
    if (left === undefined || left < 0) return "";
    const at = u.posToVal(left, "x");
    const values = drawn
      .map((mark, k) => [mark.label, u.data[k + 1][idx]])
      .filter(([label, value]) => label && value !== null && value !== undefined);
    const boxes = panel.marks.flatMap((mark) =>
      (mark.letters ?? [])
        .map((text, k) => [text, mark.details[k], mark.x[0][k], mark.x[1][k]])
        .filter(([, , a, b]) => a <= at && at <= b)
        .map(([text, detail]) => `sign ${text} ${detail}`),
    );
    const shown = values.length ? values.map(([label, value]) => `${label} ${short(value)}`) : [];
    if (!values.length && !panel.y.ticks) shown.push(labelled(panel.y.name || "y", u.posToVal(top, "y")));
    return [labelled(panel.x.name || "x", at), ...shown, ...boxes].join("\n");
  };

  const plot = (panel, host, height, name) => {
    const first = panel.marks.find((mark) => mark.kind === "line");
    const drawn = first ? panel.marks.filter((mark) => mark.kind === "line" && mark.x === first.x) : [];
    const group = groups.get(name) ?? groups.set(name, { members: [], whole: [Infinity, -Infinity] }).get(name);
    group.whole = [Math.min(group.whole[0], panel.x.ends[0]), Math.max(group.whole[1], panel.x.ends[1])];
    group.range = group.whole;
    const readout = element("div", "readout", host);
    const letters = panel.marks.some((mark) => mark.letters?.length);
    const width = host.clientWidth;
    const u = new uPlot(
      {
        width,
        height,
        legend: { show: false },
        padding: [letters ? 16 : 8, 20, 0, 0],
        scales: {
          x: { time: false, range: () => group.range },
          y: { range: () => panel.y.ends, dir: panel.downwards ? -1 : 1 },
        },
        axes: [
          { ...axis(panel.x, width), size: 24, space: 45 },
          { ...axis(panel.y, width), size: measured, space: 26 },
        ],
        series: [
          {},
          ...(drawn.length ? drawn : [{ colour: GREY }]).map((mark) => ({
            stroke: () => colour(mark.colour),
            width: mark.width,
            alpha: mark.alpha,
            dash: mark.style === "solid" ? undefined : DASHES[mark.style],
            points: { show: false },
          })),
        ],
        cursor: {
          y: false,
          points: { show: false },
          drag: { x: true, y: false, setScale: false },
          sync: { key: name, setSeries: false },
          bind: { dblclick: () => () => group.show(...group.whole) },
        },
        hooks: {
          drawClear: [layer(panel, under)],
          draw: [
            layer(panel, (mark) => !under(mark) && !drawn.includes(mark)),
            layer(panel, (mark) => mark.letters?.length, true),
          ],
          setCursor: [
            (self) => {
              readout.textContent = pointed(self, panel, drawn);
            },
          ],
          setSelect: [
            (self) => {
              const { left, width: chosen } = self.select;
              if (chosen > 3) group.show(self.posToVal(left, "x"), self.posToVal(left + chosen, "x"));
              self.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
            },
          ],
        },
      },
      drawn.length ? [panel.xs[first.x], ...drawn.map((mark) => mark.y)] : [panel.x.ends, [null, null]],
      host,
    );
    group.members.push(u);
    plots.push({ u, host, height });
  };

  // ------------------------------------------------------------------------------------------------------------
  // Figures and groups
  // ------------------------------------------------------------------------------------------------------------
  const key = (marks, parent) => {
    const list = element("ul", "key", parent);
    for (const mark of new Map(marks.map((mark) => [mark.label, mark])).values()) {
      const entry = element("li", "", list);
      const swatch = element("span", `${mark.kind} ${mark.style ?? ""} ${mark.hatched ? "hatched" : ""}`, entry);
      const alpha = Array.isArray(mark.alpha) ? Math.max(...mark.alpha) : (mark.alpha ?? 1);
      swatch.style.color = mark.colour === GREY ? "var(--soft)" : mark.colour;
      swatch.style.setProperty("--strength", `${100 * alpha}%`);
      if (mark.width) swatch.style.setProperty("--width", `${Math.max(1.5, mark.width)}px`);
      entry.append(mark.label);
    }
  };
  const figure = (place) => {
    const data = JSON.parse(place.dataset.figure);
    const name = place.dataset.group || place.closest("figure").id;
    const columns = data.panels[0].length;
    if (data.key) key(data.panels.flat().flatMap((panel) => panel?.marks.filter((mark) => mark.label) ?? []), place);
    const grid = element("div", "panels", place);
    grid.style.gridTemplateColumns = `repeat(${columns}, minmax(0, 1fr))`;
    data.panels.forEach((row, r) =>
      row.forEach((panel, c) => {
        const cell = element("div", "", grid);
        if (!panel) return;
        if (panel.title) {
          const title = element("span", "", element("div", "title", cell), panel.title);
          if (panel.tint !== GREY) title.style.borderBottom = `2px solid ${panel.tint}`;
        }
        const height = (96 * data.height) / data.panels.length - (panel.title ? 20 : 0);
        const alone = columns * data.panels.length === 1;
        plot(panel, element("div", "", cell), Math.round(Math.max(110, height)), alone ? name : `${name}-${r}-${c}`);
      }),
    );
    if (data.x_name) element("div", "title", place, data.x_name);
  };
  const controlled = (name, group) => {
    group.extent = document.createElement("output");
    group.show = (from, to) => {
      const [all, least] = [group.whole[1] - group.whole[0], (group.whole[1] - group.whole[0]) / 2000];
      const span = Math.min(Math.max(to - from, least), all);
      const start = Math.min(Math.max(from, group.whole[0]), group.whole[1] - span);
      group.range = [start, start + span];
      group.members.forEach((u) => u.setScale("x", { min: start, max: start + span }));
      const zoomed = span < all * 0.999;
      group.extent.textContent = zoomed ? `${start.toFixed(2)} to ${(start + span).toFixed(2)} s` : "";
    };
    const place = document.querySelector(`.controls[data-group="${name}"]`);
    if (!place) return;
    const about = (factor, shift) => {
      const [middle, half] = [(group.range[0] + group.range[1]) / 2, (group.range[1] - group.range[0]) / 2];
      const moved = middle + 2 * half * shift;
      group.show(moved - half * factor, moved + half * factor);
    };
    const actions = [
      ["\u2212", "Zoom out", () => about(2, 0)],
      ["+", "Zoom in", () => about(0.5, 0)],
      ["\u2190", "Earlier", () => about(1, -0.5)],
      ["\u2192", "Later", () => about(1, 0.5)],
      ["All", "Show all", () => group.show(...group.whole)],
    ];
    for (const [text, label, act] of actions) {
      const button = element("button", "", place, text);
      button.type = "button";
      button.setAttribute("aria-label", label);
      button.addEventListener("click", act);
    }
    place.append(group.extent);
  };

  // ------------------------------------------------------------------------------------------------------------
  // The page
  // ------------------------------------------------------------------------------------------------------------
  const mark = () =>
    document.querySelectorAll(".table").forEach((one) => {
      one.classList.toggle("overflows", one.scrollWidth > one.clientWidth);
    });
  const redraw = (paper = false) => {
    document.documentElement.classList.toggle("paper", paper);
    look(paper);
    for (const { u, host, height } of plots) u.setSize({ width: host.clientWidth, height });
    for (const { u } of plots) u.redraw(false, true);
    mark();
  };
  look(false);
  document.querySelectorAll(".plot").forEach(figure);
  groups.forEach((group, name) => controlled(name, group));
  mark();
  let width = document.documentElement.clientWidth;
  window.addEventListener("resize", () => {
    if (document.documentElement.clientWidth !== width) redraw(matchMedia("print").matches);
    width = document.documentElement.clientWidth;
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => redraw(matchMedia("print").matches));
  matchMedia("print").addEventListener("change", (event) => redraw(event.matches));
  window.addEventListener("beforeprint", () => redraw(true));
  window.addEventListener("afterprint", () => redraw(false));
  document.addEventListener("click", (event) => {
    const link = event.target.closest("a[data-from]");
    const group = link && groups.get(document.querySelector(`${link.hash} .plot`).dataset.group);
    if (!group) return;
    const [from, to] = [Number(link.dataset.from), Number(link.dataset.to)];
    const margin = Math.max(2 * (to - from), 0.2);
    group.show(from - margin, to + margin);
  });
})();
