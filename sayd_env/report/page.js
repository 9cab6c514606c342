// Makes the figures of a page live: each picture is replaced when it comes near the screen. Without scripts, or in
// print, the pictures stay.
"use strict";
(() => {
  const NARROW = 640, MOST_COLUMNS = 2, SIZE = 12, TITLE = 13, FAMILY = "system-ui, sans-serif";
  // Heights of a line of text of both sizes, of a row with a name beside it and with one in it, of the mode bar (px).
  const LINE = 16, TITLE_LINE = 17, ROW = 18, NAMED_ROW = 38, BAR = 32;
  const EDGE = 20, LEAST = 110, MOST = 460;
  const touch = matchMedia("(pointer: coarse)").matches;
  const config = {
    displaylogo: false, responsive: false, modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"],
    toImageButtonOptions: { scale: 2 }, displayModeBar: touch ? true : "hover",
  };
  const pen = document.createElement("canvas").getContext("2d");

  async function library() {
    const packed = document.getElementById("plotly").textContent.trim();
    const bytes = Uint8Array.from(atob(packed), (c) => c.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    const script = document.createElement("script");
    script.textContent = await new Response(stream).text();
    document.head.append(script);
  }

  // Traces and layout for a width (px): panels side by side, or below each other on a phone. The legend's height is
  // reckoned as Plotly does, unless it is known.
  function placed(figure, width, legendHeight) {
    const layout = structuredClone(figure.layout), narrow = width < NARROW;
    const data = figure.data.map((trace) => ({ ...trace }));
    const cells = arranged(figure.panels, narrow).map((p) => cellOf(p, layout, width, narrow));
    const columns = Math.max(...cells.map((c) => c.column + c.span));
    let { margin, gaps, inner } = {};
    // How many lines the names of axes take depends on the sizes of the panels, and these on the former.
    for (let pass = 0; pass < 3; pass++) {
      const left = [], right = [];
      for (let k = 0; k < columns; k++) {
        left.push(Math.max(0, ...cells.filter((c) => c.column === k).map(leftRoom)));
        right.push(Math.max(EDGE, ...cells.filter((c) => c.column + c.span - 1 === k).map(rightRoom)));
      }
      margin = { l: left[0], r: layout.coloraxis ? 84 : right.at(-1) };
      // Room before each column, of all that are left of it together.
      gaps = left.map((_, k) => left.slice(1, k + 1).reduce((sum, room, j) => sum + room + right[j], 0));
      inner = Math.max(width - margin.l - margin.r - gaps.at(-1), 60 * columns);
      cells.forEach((c) => size(c, inner, gaps, narrow));
    }
    const lines = [...new Set(cells.map((c) => c.line))].sort((a, b) => a - b);
    const lowest = new Set([...Array(columns).keys()].map((k) =>
      cells.filter((c) => c.column <= k && k < c.column + c.span).reduce((a, b) => (b.line >= a.line ? b : a))));
    for (const c of cells) {
      if (!c.x.title && (narrow || lowest.has(c)) && c.name) c.x.title = { text: c.name };
      if (c.x.title) c.x.title.text = wrapped(c.x.title.text, c.wide + (narrow ? 2 * Math.min(margin.l, margin.r) - 4 : 0), TITLE);
      c.below = tickRoom(c.x, c.wide) + (c.x.title ? 4 + TITLE_LINE * lineCount(c.x.title.text) : 0);
      c.above = c.title ? 6 + LINE * lineCount(c.title.text) : 6;
    }
    let top = 0;
    margin.t = BAR + Math.max(...cells.filter((c) => c.line === lines[0]).map((c) => c.above));
    for (const line of lines) {
      const own = cells.filter((c) => c.line === line);
      if (line !== lines[0]) top += Math.max(...own.map((c) => c.above));
      own.forEach((c) => { c.top = top; });
      top = Math.max(...own.map((c) => top + c.high + c.below)) + 8;
    }
    const high = Math.max(...cells.map((c) => c.top + c.high)), full = width - margin.l - margin.r;
    for (const c of cells) {
      c.x.domain = inside([c.left / full, (c.left + c.wide) / full]);
      for (const y of c.ys) {
        y.domain = inside([1 - (c.top + c.high) / high, 1 - c.top / high]);
        if (y.type === "log") logRows(y, c.high);
      }
      if (c.inRows) layout.annotations.push(...rowNames(c));
    }
    const named = [...data, ...layout.shapes].filter((t) => t.showlegend);
    named.forEach((t) => { t.name = wrapped(t.name, width - 70, SIZE); });
    const entry = Math.ceil(Math.max(0, ...named.map((t) => measured(t.name, SIZE)))) + 8;
    const across = Math.max(1, Math.floor(full / (entry + 45)));
    const reckoned = 10 + Math.ceil(named.length / across) * (3 + LINE * Math.max(1, ...named.map((t) => lineCount(t.name))));
    const legend = named.length ? legendHeight ?? reckoned : 0;
    margin.b = top - high + legend;
    for (const [key, axis] of Object.entries(layout)) if (/^[xy]axis/.test(key)) dress(axis, key);
    return { data, legend, layout: {
      ...layout, width, height: high + margin.t + margin.b, margin: { ...margin, autoexpand: false }, autosize: false,
      showlegend: named.length > 0,
      ...(named.length && {
        legend: { orientation: "h", xref: "container", x: 0.5, xanchor: "center", yref: "container", y: 0,
          yanchor: "bottom", font: { size: SIZE }, entrywidth: entry, tracegroupgap: 0, maxheight: 10000 },
      }),
      font: { family: FAMILY, size: SIZE, color: "#1b2430" }, paper_bgcolor: "#fff", plot_bgcolor: "#fff",
      hovermode: "closest", dragmode: touch ? false : "zoom", hoverlabel: { namelength: -1 },
    } };
  }

  // Panels with their lines and columns: one column on a phone, no more than two elsewhere.
  function arranged(panels, narrow) {
    const columns = narrow ? 1 : MOST_COLUMNS;
    if (Math.max(...panels.map((p) => p.columns)) <= columns) return panels.map((p) => ({ ...p, line: p.row }));
    return panels.map((p, k) => ({ ...p, line: Math.floor(k / columns), column: k % columns, span: 1,
      left: (k % columns) / columns, share: 1 / columns }));
  }

  // A panel with its axes, its title, and the names of its rows where it has any.
  function cellOf(p, layout, width, narrow) {
    const ys = Object.entries(layout).filter(([key, axis]) => key.startsWith("yaxis") &&
      (axisKey(p.yaxis) === key || axis.overlaying === p.yaxis)).map(([, axis]) => axis);
    const y = layout[axisKey(p.yaxis)], rows = y.ticktext?.length ?? 0;
    const longest = Math.max(0, ...(y.ticktext ?? []).map((text) => measured(text, SIZE)));
    return {
      ...p, ys, y, x: layout[axisKey(p.xaxis)], rows, high: 200, at: p.left, ratio: p.height,
      title: layout.annotations.find((note) => note.xref === `${p.xaxis} domain` && note.yref === `${p.yaxis} domain`),
      inRows: narrow && longest > 0.25 * width, titles: new Map(ys.map((axis) => [axis, axis.title?.text])),
    };
  }

  function size(c, inner, gaps, narrow) {
    c.wide = inner * c.share + gaps[c.column + c.span - 1] - gaps[c.column];
    c.left = inner * c.at + gaps[c.column];
    const ratio = narrow && !c.equal ? Math.max(c.ratio, 0.55) : c.ratio;
    c.high = Math.max(Math.min(Math.max(c.wide * ratio, LEAST), MOST), (c.inRows ? NAMED_ROW : ROW) * c.rows);
    for (const [axis, text] of c.titles) if (text) axis.title = { ...axis.title, text: wrapped(text, c.high, TITLE) };
    if (c.title) c.title.text = wrapped(c.title.text, c.wide, SIZE);
  }

  const leftRoom = (c) => (c.inRows ? 10 + titleRoom(c.y) : sideRoom(c.y, c.high));
  const rightRoom = (c) => Math.max(EDGE, ...c.ys.filter((y) => y.overlaying).map((y) => sideRoom(y, c.high)));
  const titleRoom = (y) => (y.title ? 8 + TITLE_LINE * lineCount(y.title.text) : 0);
  const sideRoom = (y, high) =>
    14 + Math.max(...tickTexts(y, high / 40).map((text) => measured(text, SIZE))) + titleRoom(y);

  // Height of what stands at the ticks of an x-axis. Words that have no room side by side are broken, or lean.
  function tickRoom(x, wide) {
    x.tickangle = 0;
    if (!x.ticktext) {
      const longest = Math.max(...tickTexts(x, wide / 80).map((text) => measured(text, SIZE)));
      x.nticks = Math.round(Math.min(Math.max(wide / (longest + 30), 2), 10));
      if (x.type === "log") x.nticks = logTicks(x, x.nticks);
      return 8 + LINE;
    }
    if (x.ticktext.every((text) => text && !Number.isNaN(Number(text.replace("\u2212", "-"))))) {
      x.ticktext = thinned(x, wide);
      return 8 + LINE;
    }
    const room = Math.max(wide / Math.abs(x.range[1] - x.range[0]) - 8, 16);
    const texts = x.ticktext.map((text) => wrapped(text, room, SIZE));
    if (texts.every((text) => measured(text, SIZE) <= room)) {
      x.ticktext = texts;
      return 8 + LINE * Math.max(...texts.map(lineCount));
    }
    x.tickangle = -45;
    return 12 + 0.71 * (LINE + Math.max(...x.ticktext.map((text) => measured(text, SIZE))));
  }

  // Numbers at places of their own: those that have room behind the one before.
  function thinned(x, wide) {
    const [first, last] = x.range, on = (value) => (x.type === "log" ? Math.log10(value) : value);
    let end = -Infinity;
    return x.ticktext.map((text, k) => {
      const half = measured(text, SIZE) / 2, at = (wide * (on(x.tickvals[k]) - first)) / (last - first);
      if (at - half < end + 4) return "";
      end = at + half;
      return text;
    });
  }

  // What will stand at the ends of an axis of about so many ticks.
  function tickTexts(axis, count) {
    if (axis.ticktext) return axis.ticktext;
    const ends = [...axis.range].sort((a, b) => a - b);
    if (axis.type === "log") return ends.map((end, k) => `${+(10 ** Math.floor(end + 0.3 * k)).toPrecision(1)}`);
    const step = Math.log10((ends[1] - ends[0]) / Math.min(Math.max(count, 4), 9));
    const digits = Math.min(Math.max(0, Math.ceil(-step)), 8);
    return ends.map((end) => end.toLocaleString("en", { minimumFractionDigits: digits, maximumFractionDigits: digits }));
  }

  // So few ticks that Plotly shows 1, 2 and 5 of a decade: all from 1 to 9 have no room.
  function logTicks(axis, count) {
    const decades = Math.abs(axis.range[1] - axis.range[0]);
    return decades < 1 ? Math.round(count) : Math.max(2, Math.min(Math.round(count), Math.floor(decades / 0.31)));
  }

  // 1, 2 and 5 of each decade up a logarithmic axis where they have room, else the decades.
  function logRows(y, high) {
    const decades = Math.abs(y.range[1] - y.range[0]);
    if (decades < 1) y.nticks = logTicks(y, Math.min(Math.max(high / 40, 4), 9) + 1);
    else Object.assign(y, { tick0: 0, dtick: 0.3 * high > LINE * decades ? "D2" : 1 });
  }

  // Names in their rows, above what the rows show.
  function rowNames(c) {
    const names = c.y.ticktext, up = Math.sign(c.y.range[1] - c.y.range[0]);
    c.y.ticktext = names.map(() => "");
    return names.map((text, k) => ({ text, xref: `${c.xaxis} domain`, yref: c.yaxis, x: 0, xanchor: "left",
      y: c.y.tickvals[k] + 0.5 * up, yanchor: "top", showarrow: false, font: { size: SIZE - 1 }, borderpad: 0 }));
  }

  // Width of a text in lines (px).
  function measured(text, pixels) {
    pen.font = `${pixels}px ${FAMILY}`;
    const plain = text.replaceAll("&lt;", "<").replaceAll("&gt;", ">").replaceAll("&amp;", "&");
    return Math.max(...plain.split("<br>").map((line) => pen.measureText(line).width));
  }

  // A text in lines no longer than a width (px), if its words are not.
  function wrapped(text, width, pixels) {
    const lines = [""];
    for (const word of text.split(/ |<br>/)) {
      const longer = [lines.at(-1), word].filter(Boolean).join(" ");
      if (lines.at(-1) && measured(longer, pixels) > width) lines.push(word);
      else lines[lines.length - 1] = longer;
    }
    return lines.join("<br>");
  }

  const inside = (ends) => ends.map((v) => Math.min(Math.max(v, 0), 1));
  const lineCount = (text) => text.split("<br>").length;
  const axisKey = (name) => `${name[0]}axis${name.slice(1)}`;

  function dress(axis, key) {
    Object.assign(axis, {
      ...(axis.overlaying && { tickmode: "auto" }), ...(axis.showgrid !== false && { gridcolor: "#e3e7ec" }),
      zeroline: false, linecolor: "#8a94a0", showline: true, mirror: !axis.overlaying, ticks: "outside", ticklen: 4,
      hoverformat: ".4~g", exponentformat: "none", automargin: false,
    });
    if (!axis.title) return;
    // Lines of a turned text follow each other to the right, on the left side towards the axis.
    const inward = key.startsWith("y") && axis.side !== "right" ? lineCount(axis.title.text) - 1 : 0;
    axis.title = { ...axis.title, font: { size: TITLE }, standoff: 6 + TITLE_LINE * inward };
  }

  async function draw(box, figure, width) {
    let now = placed(figure, width);
    // What a reader has hidden stays so.
    now.data.forEach((trace, k) => { if (box.data?.[k].visible) trace.visible = box.data[k].visible; });
    await Plotly.react(box, now.data, now.layout, config);
    const legend = box.querySelector(".legend .bg")?.getBoundingClientRect().height;
    if (!legend || Math.abs(legend - now.legend) < 2) return;
    const { data } = now;
    now = placed(figure, width, legend);
    await Plotly.react(box, data, now.layout, config);
  }

  function show(element) {
    const figure = JSON.parse(element.querySelector("script").textContent);
    element.querySelector(".title").textContent = figure.title;
    const box = element.querySelector(".plot");
    element.classList.add("live");
    const width = () => Math.max(280, Math.floor(element.getBoundingClientRect().width));
    let drawn = width();
    draw(box, figure, drawn);
    new ResizeObserver(() => {
      if (width() === drawn) return;
      drawn = width();
      draw(box, figure, drawn);
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
