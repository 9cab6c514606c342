// Makes the figures of a page live: each picture is replaced when it comes near the screen. Without scripts, or in
// print, the pictures stay.
"use strict";
(() => {
  const NARROW = 640, GAP_X = 76, GAP_Y = 66, MARGIN = { l: 66, r: 20, t: 34, b: 56 };
  const touch = matchMedia("(pointer: coarse)").matches;
  const config = {
    displaylogo: false, responsive: false, modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"],
    toImageButtonOptions: { scale: 2 },
  };

  async function library() {
    const packed = document.getElementById("plotly").textContent.trim();
    const bytes = Uint8Array.from(atob(packed), (c) => c.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    const script = document.createElement("script");
    script.textContent = await new Response(stream).text();
    document.head.append(script);
  }

  // The layout with domains for a width (px): panels side by side, or below each other on a phone.
  function placed(figure, width) {
    const layout = structuredClone(figure.layout), panels = figure.panels, narrow = width < NARROW;
    const columns = narrow ? 1 : Math.max(...panels.map((p) => p.columns));
    const right = Object.values(layout).some((axis) => axis && axis.overlaying) ? 76 : layout.coloraxis ? 84 : MARGIN.r;
    // Room for rows with names, in the first column and in the others.
    const room = (some) => Math.max(0, ...some.flatMap((p) => layout[axisKey(p.yaxis)].ticktext ?? [])
      .map((text) => 24 + 6.4 * text.length));
    const margin = { ...MARGIN, r: right, l: Math.max(narrow ? 80 : MARGIN.l, room(panels.filter((p) => narrow || !p.column))) };
    const gapX = Math.max(GAP_X, room(panels.filter((p) => p.column)));
    const names = [...figure.data, ...layout.shapes].filter((t) => t.showlegend).map((t) => t.name.length);
    const entry = 52 + 6.6 * Math.max(0, ...names);
    const across = Math.max(1, Math.floor((width - 20) / entry));
    const legend = names.length ? 14 + 20 * Math.ceil(names.length / across) : 0;
    margin.b += legend;
    const inner = width - margin.l - margin.r - (columns - 1) * gapX;
    const cells = panels.map((p, k) => {
      const share = narrow ? 1 : p.share;
      const wide = inner * share, ratio = narrow && !p.equal ? Math.max(p.height, 0.55) : p.height;
      return { ...p, line: narrow ? k : p.row, wide, high: Math.min(Math.max(wide * ratio, 110), 460) };
    });
    for (const note of layout.annotations) {
      const cell = cells.find((c) => note.xref === `${c.xaxis} domain`);
      if (cell) note.text = wrapped(note.text, cell.wide);
    }
    const gapY = GAP_Y + 15 * Math.max(0, ...layout.annotations
      .filter((note) => note.xref.endsWith("domain")).map((note) => lineCount(note.text) - 1));
    const lines = [...new Set(cells.map((c) => c.line))].sort((a, b) => a - b);
    const highest = lines.map((line) => Math.max(...cells.filter((c) => c.line === line).map((c) => c.high)));
    const high = highest.reduce((a, b) => a + b, 0) + (lines.length - 1) * gapY;
    const full = width - margin.l - margin.r;
    let top = 0;
    lines.forEach((line, k) => {
      for (const c of cells.filter((each) => each.line === line)) {
        const x = layout[axisKey(c.xaxis)], left = narrow ? 0 : inner * c.left + c.column * gapX;
        x.domain = [left / full, Math.min((left + c.wide) / full, 1)];
        if (!x.title && (narrow || line === lines.at(-1)) && c.name) x.title = { text: c.name };
        for (const [key, axis] of Object.entries(layout))
          if (key.startsWith("yaxis") && (axisKey(c.yaxis) === key || axis.overlaying === c.yaxis))
            Object.assign(axis, {
              domain: [1 - (top + c.high) / high, 1 - top / high].map((v) => Math.min(Math.max(v, 0), 1)),
              ...(axis.title && { title: { text: wrapped(axis.title.text, c.high) } }),
            });
      }
      top += highest[k] + gapY;
    });
    for (const [key, axis] of Object.entries(layout)) if (/^[xy]axis/.test(key)) dress(axis);
    return {
      ...layout, width, height: high + margin.t + margin.b, margin, autosize: false,
      showlegend: names.length > 0,
      ...(names.length && {
        legend: { orientation: "h", xref: "container", x: 0.5, xanchor: "center", yref: "container", y: 0,
          yanchor: "bottom", font: { size: 12 }, entrywidth: entry - 42 },
      }),
      font: { family: "system-ui, sans-serif", size: 12, color: "#1b2430" }, paper_bgcolor: "#fff", plot_bgcolor: "#fff",
      hovermode: "closest", dragmode: touch ? false : "zoom", hoverlabel: { namelength: -1 },
    };
  }

  // A text in lines no longer than a width (px).
  function wrapped(text, width) {
    const most = Math.max(12, Math.floor(width / 6.6)), lines = [""];
    for (const word of text.split(/ |<br>/)) {
      if (lines.at(-1) && lines.at(-1).length + word.length >= most) lines.push(word);
      else lines.push([lines.pop(), word].filter(Boolean).join(" "));
    }
    return lines.join("<br>");
  }

  const lineCount = (text) => text.split("<br>").length;
  const axisKey = (name) => `${name[0]}axis${name.slice(1)}`;

  function dress(axis) {
    Object.assign(axis, {
      ...(axis.overlaying && { tickmode: "auto" }), ...(axis.showgrid !== false && { gridcolor: "#e3e7ec" }), zeroline: false, linecolor: "#8a94a0", showline: true, mirror: !axis.overlaying,
      ticks: "outside", ticklen: 4, hoverformat: ".4~g", exponentformat: "none", automargin: false,
    });
    if (axis.title) axis.title = { ...axis.title, standoff: 6 + 15 * (lineCount(axis.title.text) - 1) };
  }

  function show(element) {
    const figure = JSON.parse(element.querySelector("script").textContent);
    element.querySelector(".title").textContent = figure.title;
    const box = element.querySelector(".plot");
    element.classList.add("live");
    const width = () => Math.max(280, Math.floor(element.getBoundingClientRect().width));
    let drawn = width();
    Plotly.newPlot(box, figure.data, placed(figure, drawn), { ...config, displayModeBar: touch ? true : "hover" });
    new ResizeObserver(() => {
      if (width() === drawn) return;
      drawn = width();
      Plotly.react(box, figure.data, placed(figure, drawn), config);
    }).observe(element);
  }

  async function start() {
    const figures = document.querySelectorAll("figure:has(> script)");
    if (!figures.length || typeof DecompressionStream === "undefined") return;
    await library();
    const near = new IntersectionObserver((entries) => {
      for (const entry of entries.filter((each) => each.isIntersecting)) {
        near.unobserve(entry.target);
        show(entry.target);
      }
    }, { rootMargin: "600px" });
    figures.forEach((each) => near.observe(each));
  }
  start();
})();
