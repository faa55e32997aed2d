"use strict";
// Everything that the page shows beside its text comes packed with it; nothing is fetched.
async function unpacked(id) {
  const packed = Uint8Array.from(atob(document.getElementById(id).textContent), c => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).text();
}

const style = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const narrow = () => window.innerWidth < 640;
// The only button saves a figure as a picture, for a document.
const config = { responsive: true, displaylogo: false, modeBarButtons: [["toImage"]],
  toImageButtonOptions: { format: "png", scale: 3 } };

// What depends on light or dark: set again in every figure when that changes.
function themed(layout) {
  const axis = { gridcolor: style("--line"), zerolinecolor: style("--line"), linecolor: style("--line") };
  const out = { ...layout, paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
    modebar: { bgcolor: "rgba(0,0,0,0)", color: style("--faint"), activecolor: style("--ink") },
    font: { family: "system-ui, sans-serif", size: 13, color: style("--ink") },
    hoverlabel: { bgcolor: style("--panel"), font: { color: style("--ink") }, bordercolor: style("--line") } };
  if (narrow() && layout.legend && !layout.scene)
    out.legend = { ...layout.legend, y: -0.2, yanchor: "top", font: { size: 11 } };
  for (const name of Object.keys(layout)) if (/^[xy]axis\d*$/.test(name)) out[name] = { ...axis, ...layout[name] };
  if (layout.scene) {
    out.scene = { ...layout.scene };
    for (const name of ["xaxis", "yaxis", "zaxis"])
      out.scene[name] = { ...layout.scene[name], ...axis, color: style("--faint"), showbackground: false };
  }
  return out;
}
function inked(traces) {  // the colour "ink" is that of text
  return JSON.parse(JSON.stringify(traces), (_, value) => value === "ink" ? style("--ink") : value);
}
const drawn = [];
function drawer(element, traces, layout) {
  const paint = () => Plotly.react(element, traces(), themed(layout()), config);
  drawn.push(paint);
  return paint;
}
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => drawn.forEach(paint => paint()));

function figure(element, { traces, layout }) {
  return drawer(element, () => inked(traces), () => layout)();
}

// The belief in space, at one moment of the run.
function scene(element, data) {
  const plot = element.querySelector(".plot"), slider = element.querySelector("input");
  const output = element.querySelector("output"), play = element.querySelector("button.play");
  const seen = element.querySelector(".seen"), buttons = [...element.querySelectorAll(".moments button")];
  const metres = values => values.map(value => value / 1000);
  let at = Number(slider.value), timer = null, paths = [], pathsInk = null;

  const now = () => {
    const moment = data.moments[at], weights = moment.weights;
    const shade = weight => `rgb(${[0, 1, 2].map(i => Math.round(data.none[i] + weight * (data.all[i] - data.none[i])))})`;
    const [x, y, z] = moment.particles.map(metres), [mx, my, mz] = moment.modes.map(metres);
    const [fx, fy, fz] = moment.camera.map(metres);
    const belief = [
      { type: "scatter3d", mode: "markers", name: "particles", x, y, z, hoverinfo: "skip",
        marker: { size: 4, opacity: 0.75, line: { width: 0 }, color: moment.of.map(i => shade(weights[i])) } },
      { type: "scatter3d", mode: "markers+text", name: "modes", x: mx, y: my, z: mz,
        text: weights.map(w => `${Math.round(100 * w)} %`), textposition: "top center",
        hovertemplate: "mode of %{text}<br>%{x:.2f}, %{y:.2f}, %{z:.2f} m<extra></extra>",
        marker: { size: weights.map(w => 6 + 8 * w), color: weights.map(shade), line: { width: 1, color: "ink" } } },
      { type: "scatter3d", mode: "lines", name: "camera", x: fx, y: fy, z: fz, hoverinfo: "skip",
        line: { width: 4, color: shade(1) } },
    ];
    if (moment.truth) {
      const [tx, ty, tz] = moment.truth.map(metres);
      belief.push({ type: "scatter3d", mode: "lines", name: "true camera", x: tx, y: ty, z: tz, hoverinfo: "skip",
        line: { width: 4, color: "ink" } });
    }
    if (pathsInk !== style("--ink")) [pathsInk, paths] = [style("--ink"), inked(data.paths)];
    return [...paths, ...inked(belief)];
  };
  const away = Math.max(1, 0.85 * Math.hypot(data.ratio.x, data.ratio.y, data.ratio.z));  // so that all of the box is seen
  const layout = () => ({ uirevision: "kept", margin: { l: 0, r: 0, t: 0, b: 0 }, showlegend: true,
    legend: narrow() ? { orientation: "h", y: 0, yanchor: "top", font: { size: 11 } } : { x: 0, y: 1, bgcolor: "rgba(0,0,0,0)" },
    scene: { aspectmode: "manual", aspectratio: data.ratio, uirevision: "kept",
      camera: { eye: { x: away, y: -away, z: 0.55 * away } }, ...Object.fromEntries(["x", "y", "z"].map((name, i) =>
        [`${name}axis`, { title: { text: `${name} [m]` }, range: data.ranges[i] }])) } });

  function show(index) {
    at = Math.max(0, Math.min(data.moments.length - 1, index));
    const moment = data.moments[at];
    slider.value = at;
    output.textContent = `${moment.time_s.toFixed(1)} s · ${moment.status} · ${moment.weights.length} ` +
      (moment.weights.length === 1 ? "mode" : `modes, best ${Math.round(100 * moment.weights[0])} %`);
    slider.setAttribute("aria-valuetext", output.textContent);
    let chosen = null;
    for (const button of buttons) {
      if (Number(button.dataset.moment) <= at) chosen = button;
      button.setAttribute("aria-pressed", "false");
    }
    if (chosen) chosen.setAttribute("aria-pressed", "true");
    if (seen) {
      seen.querySelector("img").src = moment.image;
      seen.querySelector("figcaption").textContent = `Image at ${moment.time_s.toFixed(1)} s`;
    }
    return paint();
  }
  function stop() {
    clearInterval(timer);
    timer = null;
    play.textContent = "▶ Play";
  }
  play.addEventListener("click", () => {
    if (timer) return stop();
    if (at === data.moments.length - 1) show(0);
    play.textContent = "❚❚ Pause";
    timer = setInterval(() => at < data.moments.length - 1 ? show(at + 1) : stop(), 100);
  });
  slider.addEventListener("input", () => { stop(); show(Number(slider.value)); });
  for (const button of buttons) button.addEventListener("click", () => { stop(); show(Number(button.dataset.moment)); });
  const paint = drawer(plot, now, layout);
  return show(at);
}

(async () => {
  const figures = document.querySelectorAll("[data-figure]");
  if (!figures.length) return;
  const data = JSON.parse(await unpacked("data"));
  const script = document.createElement("script");
  script.textContent = await unpacked("plotly");
  document.head.append(script);
  for (const element of figures) {
    const content = data[element.dataset.figure];
    await (content.moments ? scene(element, content) : figure(element.querySelector(".plot"), content));
  }
  document.documentElement.dataset.ready = "yes";
})();
