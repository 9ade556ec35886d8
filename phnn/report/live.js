// Zoomable plots, downloads and copy buttons of a report. Everything works without this script, as pictures.
"use strict";
(() => {
  const HEIGHTS = [210, 190, 130];
  const ABSENT = 65535;
  const root = document.documentElement;
  const groups = [];

  const colour = (name) => () => getComputedStyle(root).getPropertyValue(`--${name}`).trim();
  const shown = (value, digits = 5) =>
    value === null || value === undefined || Number.isNaN(value) ? "–" : String(Number(value.toPrecision(digits))).replace("-", "−");

  // A trace from whole numbers of 16 bits, see phnn/report/plots.py; null where there is no value.
  function unpacked(series) {
    const bytes = Uint8Array.from(atob(series.data), (letter) => letter.charCodeAt(0));
    const view = new DataView(bytes.buffer);
    return Array.from({ length: bytes.length / 2 }, (_, i) => {
      const number = view.getUint16(2 * i, true);
      return number === ABSENT ? null : series.low + series.step * number;
    });
  }

  function times(content) {
    const count = unpackedLength(content);
    return Array.from({ length: count }, (_, i) => content.start + content.step * i);
  }

  const unpackedLength = (content) => atob(content.panels[0].series[0].data).length / 2;

  // Shade what was not scored, and draw the band of the noise.
  function marks(content, panel) {
    return (plot) => {
      const { ctx, bbox } = plot;
      ctx.save();
      ctx.beginPath();
      ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
      ctx.clip();
      ctx.fillStyle = colour("unscored")();
      for (const [from, to] of content.unscored) {
        const left = plot.valToPos(from, "x", true);
        ctx.fillRect(left, bbox.top, plot.valToPos(to, "x", true) - left, bbox.height);
      }
      if (panel.band) {
        ctx.strokeStyle = colour("ink")();
        ctx.lineWidth = devicePixelRatio;
        ctx.setLineDash([5 * devicePixelRatio, 3 * devicePixelRatio]);
        for (const level of [panel.band, -panel.band]) {
          const top = Math.round(plot.valToPos(level, "y", true)) + 0.5;
          ctx.beginPath();
          ctx.moveTo(bbox.left, top);
          ctx.lineTo(bbox.left + bbox.width, top);
          ctx.stroke();
        }
      }
      ctx.restore();
    };
  }

  const WIDTHS = { measured: 4, before: 1.4, after: 1.1, input: 1.2 };

  function line(series, isOutput) {
    return {
      label: series.label,
      stroke: colour(series.role),
      width: isOutput ? WIDTHS[series.role] : 1,
      dash: isOutput && series.role === "before" ? [5, 3] : undefined,
      points: { show: false },
      pxAlign: 0, // between pixels, or a slow slope would have steps
      value: (_, value) => shown(value),
    };
  }

  function axis(label, size) {
    return {
      label, size, space: label === null || label === "time (s)" ? 50 : 22, labelSize: 18, labelGap: 0, gap: 3, labelFont: "12px system-ui, sans-serif", font: "11px system-ui, sans-serif",
      stroke: colour("soft"), grid: { stroke: colour("line"), width: 1 }, ticks: { stroke: colour("line"), width: 1, size: 5 },
      values: (_, splits) => splits.map((value) => shown(value, 8)),
    };
  }

  function options(group, content, number) {
    const panel = content.panels[number];
    const last = number === content.panels.length - 1;
    const whole = (plot) => plot.scales.x.min <= group.from && plot.scales.x.max >= group.to;
    const range = (plot, low, high) => {
      if (panel.limit && whole(plot)) return [-panel.limit, panel.limit];
      if (low === null || high === null) return [-1, 1];
      return uPlot.rangeNum(low, high, 0.08, false);
    };
    return {
      width: group.width(),
      height: HEIGHTS[number],
      class: "panel",
      cursor: {
        drag: { x: true, y: false, dist: 4 },
        points: { size: 6 },
        // Only the place of the cursor is shared this way; the zoom is shared exactly, see `zoomed`.
        sync: { key: group.key, filters: { pub: (type) => type === "mousemove" || type === "mouseleave" } },
      },
      scales: { x: { time: false, range: (_, low, high) => [low, high] }, y: { range } },
      axes: [axis(last ? "time (s)" : null, last ? 24 : 22), axis(panel.label, 52)],
      series: [{ label: "time (s)", value: (_, value) => shown(value, 7) }, ...panel.series.map((s) => line(s, number === 0))],
      hooks: { setScale: [(plot, scale) => scale === "x" && zoomed(group, plot)], drawAxes: [marks(content, panel)] },
    };
  }

  // All plots of a recording show the same stretch of time.
  function zoomed(group, plot) {
    if (group.busy) return;
    group.busy = true;
    const { min, max } = plot.scales.x;
    for (const other of group.plots) if (other !== plot) other.setScale("x", { min, max });
    group.busy = false;
  }

  function zoom(group, from, to) {
    if (group.plots.length && to > from) group.plots[0].setScale("x", { min: Math.max(from, group.from), max: Math.min(to, group.to) });
  }

  function moved(group, share, factor) {
    const { min, max } = group.plots[0].scales.x;
    const width = Math.min((max - min) * factor, group.to - group.from);
    const middle = 0.5 * (min + max) + share * (max - min);
    const from = Math.min(Math.max(middle - 0.5 * width, group.from), group.to - width);
    zoom(group, from, from + width);
  }

  function button(text, title, act) {
    const made = document.createElement("button");
    made.type = "button";
    made.textContent = text;
    made.title = title;
    made.addEventListener("click", act);
    return made;
  }

  function toolbar(group, content) {
    const bar = document.createElement("div");
    bar.className = "tools";
    bar.append(
      button("all", "Show the whole recording (or double-click a plot)", () => zoom(group, group.from, group.to)),
      button("+", "Zoom in", () => moved(group, 0, 0.5)),
      button("−", "Zoom out", () => moved(group, 0, 2)),
      button("←", "Earlier", () => moved(group, -0.5, 1)),
      button("→", "Later", () => moved(group, 0.5, 1)),
    );
    if (content.worst) bar.append(button("worst", "Where the base model is worst", () => zoom(group, ...content.worst)));
    const hint = document.createElement("span");
    hint.textContent = "drag to zoom, double-click for all" + (content.width > 1 ? `; smallest and largest of every ${content.width} samples` : "");
    bar.append(hint);
    return bar;
  }

  // Plots cost memory: those in a closed part of the page are made when it is opened.
  function build(box) {
    const content = JSON.parse(document.getElementById(box.dataset.plots).textContent);
    const x = times(content);
    const group = { key: box.dataset.plots, name: content.name, plots: [], busy: false, from: x[0], to: x[x.length - 1] };
    group.width = () => Math.max(240, box.clientWidth);
    group.zoom = (from, to) => zoom(group, from, to);
    box.append(toolbar(group, content));
    content.panels.forEach((panel, number) => {
      const heading = document.createElement("div");
      heading.className = "plot-title";
      heading.textContent = panel.title + (panel.band ? "; dashed: ± 2 × noise" : "") + (number === 0 && content.unscored.length ? "; grey: not scored" : "");
      box.append(heading);
      group.plots.push(new uPlot(options(group, content, number), [x, ...panel.series.map(unpacked)], box));
    });
    group.content = content;
    groups.push(group);
    new ResizeObserver(() => {
      group.plots.forEach((plot, i) => plot.width !== group.width() && plot.setSize({ width: group.width(), height: HEIGHTS[i] }));
    }).observe(box);
  }

  function prepare(box) {
    const folded = box.closest("details");
    if (!folded || folded.open) return build(box);
    return folded.addEventListener("toggle", () => build(box), { once: true });
  }

  // The points of the plots as text, each number as precise as it is stored.
  function table(id) {
    const content = JSON.parse(document.getElementById(id).textContent);
    const quoted = (text) => `"${text.replaceAll('"', '""')}"`;
    const columns = [times(content)], heads = ["time (s)"];
    for (const panel of content.panels) {
      for (const series of panel.series) {
        heads.push(`${series.label}: ${panel.label}`);
        columns.push(unpacked(series));
      }
    }
    const rows = columns[0].map((_, i) => columns.map((column) => (column[i] === null ? "" : Number(column[i].toPrecision(9)))).join(","));
    return [heads.map(quoted).join(","), ...rows].join("\r\n") + "\r\n";
  }

  function offered(link) {
    link.addEventListener("click", () => {
      if (link.href.startsWith("blob:")) return;
      link.href = URL.createObjectURL(new Blob([table(link.dataset.table)], { type: "text/csv" }));
    });
  }

  function copied(made) {
    const source = document.getElementById(made.dataset.copy);
    made.addEventListener("click", async () => {
      getSelection().selectAllChildren(source);
      let done = false;
      try {
        await navigator.clipboard.writeText(source.textContent);
        done = true;
      } catch {
        done = document.execCommand("copy");
      }
      made.textContent = done ? "copied" : "selected: press Ctrl+C";
      setTimeout(() => (made.textContent = "copy"), 3000);
    });
  }

  root.classList.add("live");
  document.querySelectorAll("[data-plots]").forEach(prepare);
  document.querySelectorAll("a[data-table]").forEach(offered);
  document.querySelectorAll("button[data-copy]").forEach(copied);
  // The page alone is enough: pictures are saved from it, not from the folder beside it.
  document.querySelectorAll("a[data-picture]").forEach((link) => {
    link.href = link.closest("figure").querySelector("img").src;
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => groups.forEach((g) => g.plots.forEach((p) => p.redraw(false))));
  window.phnnReport = { groups };
})();
