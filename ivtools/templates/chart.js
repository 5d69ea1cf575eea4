"use strict";
/* Draws every <figure class="chart"> of the page with uPlot: panels that share time and cursor.

   A figure with data-source asks its server for the samples of the time that is visible. Figures
   inside an element with data-linked show the same time. */
const ivtoolsCharts = (function () {
  const PAUSE = 60; // ms between the last zoom and the question to the server
  const drawn = [];
  const STEP = 0.2; // of the visible time that a key moves or zooms
  const colour = (name) =>
    getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
  const WIDTH = { measured: 2 };

  function numbers(text, Kind) {
    const raw = atob(text);
    const bytes = Uint8Array.from(raw, (c) => c.charCodeAt(0));
    return Array.from(new Kind(bytes.buffer), (x) => (Number.isNaN(x) ? null : x));
  }

  function shown(x, digits) {
    return x == null ? "–" : Number(x.toPrecision(digits)).toString();
  }

  /* Ticks with as many digits as tell them apart. */
  function ticks(_, values) {
    const step = Math.abs(values[1] - values[0]) || 1;
    const small = step < 1e-4, places = Math.min(Math.max(Math.ceil(-Math.log10(step) - 1e-9), 0) + 1, 9);
    return values.map((x) => (x === 0 ? "0" : small ? Number(x.toPrecision(3)).toExponential() : String(Number(x.toFixed(places)))));
  }

  function axis(label, size) {
    return {
      label: label || null, size, labelSize: 18, gap: 3, labelGap: 0, values: ticks,
      font: "12px system-ui, sans-serif", labelFont: "12px system-ui, sans-serif",
      stroke: () => colour("ink"),
      grid: { stroke: () => colour("grid"), width: 1 },
      ticks: { stroke: () => colour("line"), width: 1 },
    };
  }

  function shade(plot, regions) {
    plot.ctx.save();
    plot.ctx.fillStyle = colour("event");
    for (const r of regions.filter((r) => r.shaded)) {
      const left = Math.max(plot.valToPos(r.start, "x", true), plot.bbox.left);
      const right = Math.min(plot.valToPos(r.stop, "x", true), plot.bbox.left + plot.bbox.width);
      if (right > left) {
        plot.ctx.fillRect(left, plot.bbox.top, Math.max(right - left, 2), plot.bbox.height);
      }
    }
    plot.ctx.restore();
  }

  function height(count, rank) {
    return count === 1 ? 260 : rank === 0 ? 220 : 150;
  }

  /* Forget figures that have left the page. */
  function prune() {
    for (const chart of drawn.filter((c) => !c.figure.isConnected)) {
      drawn.splice(drawn.indexOf(chart), 1);
      chart.forget();
    }
  }

  function draw(figure) {
    const rank = ++draw.count;
    const source = figure.dataset.source;
    const linked = source && figure.closest("[data-linked]");
    const content = JSON.parse(figure.querySelector("script").textContent);
    const t = numbers(content.t, Float64Array).map((x) => x + content.begin);
    const whole = [t[0], t[t.length - 1]];
    const place = figure.querySelector(".panels");
    const plots = [];
    let busy = false, asked = 0, waiting = 0, stale = false, began = 0;

    function show(from, to, own = true) {
      const least = 4 * (whole[1] - whole[0]) / 1e6;
      if (to - from < least) return;
      const span = own ? Math.min(to - from, whole[1] - whole[0]) : to - from;
      const start = own ? Math.min(Math.max(from, whole[0]), whole[1] - span) : from;
      busy = true;
      for (const plot of plots) plot.setScale("x", { min: start, max: start + span });
      busy = false;
      if (own) began = performance.now();
      if (source && !content.complete) {
        clearTimeout(waiting);
        waiting = setTimeout(refine, PAUSE);
      }
      if (own && linked) {
        for (const other of drawn) if (other.linked && other.show !== show) other.show(start, start + span, false);
      }
    }

    /* Replace the samples by those of the visible time, as finely as the server gives them. */
    async function refine() {
      const box = figure.getBoundingClientRect(), mine = ++asked;
      stale = box.bottom < 0 || box.top > innerHeight;
      if (stale || !figure.isConnected) return;
      const [from, to] = view();
      let part = content;
      if (from > whole[0] || to < whole[1]) {
        const answer = await fetch(`${source}?from=${from}&to=${to}`).catch(() => null);
        if (!answer || !answer.ok || mine !== asked) return;
        part = await answer.json();
        if (mine !== asked) return;
      }
      const times = numbers(part.t, Float64Array).map((x) => x + part.begin);
      busy = true;
      plots.forEach((plot, k) => {
        plot.setData([times, ...part.panels[k].series.map((s) => numbers(s.values, Float32Array))], false);
        plot.setScale("x", { min: from, max: to });
      });
      busy = false;
      figure.dataset.refined = (performance.now() - began).toFixed(1);
      figure.dataset.samples = times.length;
    }
    const all = () => show(whole[0], whole[1]);
    const view = () => [plots[0].scales.x.min, plots[0].scales.x.max];
    function zoom(factor) {
      const [a, b] = view(), middle = (a + b) / 2, half = (b - a) / 2 * factor;
      show(middle - half, middle + half);
    }
    function move(share) {
      const [a, b] = view();
      show(a + share * (b - a), b + share * (b - a));
    }
    const atRegion = (x) => content.regions.find((r) => r.shaded && r.start <= x && x <= r.stop);
    function jump(r) {
      const margin = 0.25 * (r.stop - r.start);
      show(r.start - margin, r.stop + margin);
    }

    content.panels.forEach((panel, k) => {
      const last = k === content.panels.length - 1;
      const series = panel.series.map((s) => ({
        label: s.label,
        stroke: () => colour(s.role),
        width: WIDTH[s.role] || 1,
        points: { show: false },
        value: (_, x) => shown(x, 4) + (x == null || !panel.unit ? "" : " " + panel.unit),
      }));
      const options = {
        width: place.clientWidth, height: height(content.panels.length, k) + (last ? 18 : 0),
        series: [{ label: content.across.split(",")[0], value: (_, x) => (x == null ? "–" : x.toFixed(3) + (content.across.includes(", s") ? " s" : "")) }, ...series],
        scales: {
          x: { time: false },
          y: {
            range: (u, low, high) => {
              const { min, max } = u.scales.x;
              const all = min == null || (min <= whole[0] && max >= whole[1]);
              if (panel.limits && all) return panel.limits;
              if (low == null) return [-1, 1];
              const margin = 0.06 * (high - low) || 0.1 * Math.abs(high) || 1;
              return [low - margin, high + margin];
            },
          },
        },
        axes: [last ? axis(content.across, 34) : { ...axis("", 4), ticks: { show: false }, values: (u, v) => v.map(() => "") }, { ...axis(panel.label, 50), space: 24 }],
        cursor: {
          sync: { key: linked ? "linked" : "chart" + rank, scales: ["x", null] },
          drag: { x: true, y: false, dist: 6 },
        },
        legend: { live: true },
        hooks: {
          drawClear: [(u) => shade(u, content.regions)],
          setScale: [(u, key) => {
            if (key !== "x" || busy) return;
            show(u.scales.x.min, u.scales.x.max);
          }],
        },
      };
      const data = [t, ...panel.series.map((s) => numbers(s.values, Float32Array))];
      const plot = new uPlot(options, data, place);
      const canvas = plot.root.querySelector("canvas");
      canvas.setAttribute("role", "img");
      canvas.setAttribute("aria-label", panel.label + ": " + panel.series.map((s) => s.label).join(", "));
      plot.over.addEventListener("click", () => {
        const region = plot.select.width === 0 && atRegion(plot.posToVal(plot.cursor.left, "x"));
        if (region) jump(region);
      });
      plot.over.addEventListener("dblclick", all);
      switches(plot);
      plots.push(plot);
    });

    const actions = {
      "+": () => zoom(1 / (1 + 5 * STEP)), "-": () => zoom(1 + 5 * STEP),
      ArrowLeft: () => move(-STEP), ArrowRight: () => move(STEP), 0: all, Home: all,
    };
    place.addEventListener("keydown", (event) => {
      const action = actions[event.key];
      if (!action || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      action();
    });
    for (const button of figure.querySelectorAll("button")) {
      const region = content.regions[button.dataset.region];
      button.addEventListener("click", region ? () => jump(region) : actions[button.dataset.key]);
    }
    touch(place, plots, show, view);
    const size = new ResizeObserver(() => {
      for (const plot of plots) plot.setSize({ width: place.clientWidth, height: plot.height });
    });
    size.observe(place);
    const seen = new IntersectionObserver(() => { if (stale) refine(); });
    seen.observe(figure);
    drawn.push({
      figure, plots, linked, show, view,
      forget: () => { size.disconnect(); seen.disconnect(); plots.forEach((p) => p.destroy()); },
    });
    const peer = linked && drawn.find((c) => c.linked && c.show !== show);
    if (peer) {
      const [from, to] = peer.view();
      if (from > whole[0] || to < whole[1]) show(from, to, false);
    }
  }
  draw.count = 0;

  /* The page is light, or dark, from now on. */
  function recolour(plot) {
    plot.redraw(false);
    plot.root.querySelectorAll(".u-legend .u-series").forEach((row, k) => {
      const marker = row.querySelector(".u-marker"), stroke = plot.series[k].stroke;
      if (marker && k) marker.style.borderColor = typeof stroke === "function" ? stroke(plot, k) : stroke;
    });
  }

  /* Names in the legend switch their signal; with the keyboard as well. */
  function switches(plot) {
    for (const label of [...plot.root.querySelectorAll(".u-legend .u-series th")].slice(1)) {
      label.tabIndex = 0;
      label.setAttribute("role", "switch");
      label.setAttribute("aria-checked", "true");
      label.addEventListener("click", () => setTimeout(() => label.setAttribute(
        "aria-checked", String(!label.parentElement.classList.contains("u-off")))));
      label.addEventListener("keydown", (event) => {
        if (event.key === "Enter" || event.key === " ") {
          event.preventDefault();
          event.stopPropagation();
          label.click();
        }
      });
    }
  }

  /* Two fingers zoom and move; one scrolls the page. */
  function touch(place, plots, show, view) {
    let begin = null;
    const pair = (event) => [...event.touches].slice(0, 2).map((f) => {
      const box = plots[0].over.getBoundingClientRect();
      return (f.clientX - box.left) / box.width;
    }).sort((a, b) => a - b);
    place.addEventListener("touchstart", (event) => {
      if (event.touches.length === 2) begin = { at: pair(event), view: view() };
    }, { passive: true });
    place.addEventListener("touchmove", (event) => {
      if (!begin || event.touches.length !== 2) return;
      event.preventDefault();
      const now = pair(event), [a, b] = begin.view;
      const held = begin.at.map((x) => a + x * (b - a));
      const span = (held[1] - held[0]) / Math.max(now[1] - now[0], 0.02);
      show(held[0] - now[0] * span, held[0] + (1 - now[0]) * span);
    }, { passive: false });
    place.addEventListener("touchend", () => { begin = null; });
  }

  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () =>
    drawn.forEach((chart) => chart.plots.forEach(recolour)));

  return {
    draw: (root) => { prune(); root.querySelectorAll("figure.chart").forEach(draw); },
    drawn,
  };
})();
ivtoolsCharts.draw(document);
