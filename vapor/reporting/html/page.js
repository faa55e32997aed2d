"use strict";
// Everything that the page shows beside its text comes packed with it; nothing is fetched.
function bytes(base64) {
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(base64);
  const characters = atob(base64), out = new Uint8Array(characters.length);
  for (let i = 0; i < out.length; i++) out[i] = characters.charCodeAt(i);
  return out;
}
async function unpacked(id) {
  const stream = new Blob([bytes(document.getElementById(id).textContent)]).stream();
  return new Response(stream.pipeThrough(new DecompressionStream("gzip"))).text();
}

const style = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const narrow = () => window.innerWidth < 640;
// The only button saves a figure as a picture, for a document.
const config = { responsive: true, displaylogo: false, modeBarButtons: [["toImage"]],
  plotGlPixelRatio: Math.min(window.devicePixelRatio, 2), toImageButtonOptions: { format: "png", scale: 3 } };

// What depends on light or dark: set again in every figure when that changes.
function themed(layout) {
  const axis = { gridcolor: style("--line"), zerolinecolor: style("--line"), linecolor: style("--line") };
  const out = { ...layout, paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
    modebar: { bgcolor: "rgba(0,0,0,0)", color: style("--faint"), activecolor: style("--ink") },
    font: { family: "system-ui, sans-serif", size: 13, color: style("--ink") },
    hoverlabel: { bgcolor: style("--panel"), font: { color: style("--ink") }, bordercolor: style("--line") } };
  if (narrow() && layout.legend && !layout.scene) {
    out.legend = { ...layout.legend, y: -0.2, yanchor: "top", font: { size: 11 } };
    out.margin = { ...layout.margin, t: 30 };  // for the button
  }
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

// The box of a scene and the visible paths in it, about its middle, in units of the scene; and which way is up.
function boxed(data) {
  const sides = ["x", "y", "z"].map(name => data.ratio[name]);
  const [middles, units] = [data.ranges.map(([low, high]) => (low + high) / 2),
    data.ranges.map(([low, high], i) => sides[i] / (high - low))];
  const corners = [0, 1, 2, 3, 4, 5, 6, 7].map(n => sides.map((side, i) => (n >> i & 1 ? side : -side) / 2));
  const path = data.paths.filter(each => each.visible === true).flatMap(({ x, y, z }) => x.map((_, i) => [x[i], y[i], z[i]]))
    .filter((point, i) => i % 5 === 0 && point[0] !== null)
    .map(point => point.map((value, i) => (value - middles[i]) * units[i]));
  return { corners, path: path.length ? path : corners, up: data.up };
}

// The eye that sees all of a box as large as possible, from the direction in which the path fills the view best.
function camera({ corners, path, up }, width, height) {
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const sum = (...terms) => [0, 1, 2].map(i => terms.reduce((total, [factor, vector]) => total + factor * vector[i], 0));
  const xyz = ([x, y, z]) => ({ x, y, z });
  const tangent = Math.tan(Math.PI / 8);  // Plotly's view is 45° high
  const room = [width - 106, height - 78].map(side => tangent * side / height);  // beside the labels of the axes
  const level = up[0] ? [0, 1, 0] : [1, 0, 0], aside = cross(up, level);
  let best = null;
  for (let turn = 30; turn < 360; turn += 10) for (const rise of [20, 28, 36]) {
    if (turn % 90 < 30 || turn % 90 > 60) continue;  // so that no axis of the map is seen end on
    const [a, b] = [turn * Math.PI / 180, rise * Math.PI / 180];
    const back = sum([Math.cos(b) * Math.cos(a), level], [Math.cos(b) * Math.sin(a), aside], [Math.sin(b), up]);
    const right = sum([-Math.sin(a), level], [Math.cos(a), aside]), axes = [right, cross(back, right)];
    // Along each axis of the view all corners are between its edges, which the distance sets apart.
    const edges = axes.map((axis, k) => [1, -1].map(sign =>
      Math.max(...corners.map(corner => sign * dot(corner, axis) + room[k] * dot(corner, back)))));
    const distance = Math.max(...edges.map(([high, low], k) => (high + low) / (2 * room[k])));
    const middle = edges.map(([high, low]) => (high - low) / 2);
    middle[0] -= 28 * tangent * distance / height;  // more of the room on the left, where the upright axis has its name
    const fills = axes.reduce((product, axis, k) => {
      const at = path.map(point => (dot(point, axis) - middle[k]) / (room[k] * (distance - dot(point, back))));
      return product * (Math.max(...at) - Math.min(...at));
    }, 1);
    if (best === null || fills > 1.01 * best.fills) {
      const centre = sum([middle[0], axes[0]], [middle[1], axes[1]]);
      best = { fills, camera: { up: xyz(up), center: xyz(centre), eye: xyz(sum([1, centre], [distance, back])) } };
    }
  }
  return best.camera;
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
  const box = boxed(data), room = () => plot.clientHeight - (narrow() ? 110 : 70);  // above the legend
  // No more than have a place beside each other on an axis of a part of the longest one, which is seen aslant.
  const ticks = part => Math.max(2, Math.min(8, Math.round(0.7 * part * Math.min(room(), 1.5 * plot.clientWidth) / 30)));
  const layout = () => ({ uirevision: "kept", margin: { l: 0, r: 0, t: 0, b: 0 }, showlegend: true,
    legend: { orientation: "h", x: 0, y: 0, yanchor: "top", font: { size: narrow() ? 11 : 12 } },
    scene: { aspectmode: "manual", aspectratio: data.ratio, uirevision: "kept",
      camera: camera(box, plot.clientWidth, room()), ...Object.fromEntries(["x", "y", "z"].map((name, i) =>
        [`${name}axis`, { title: { text: `${name} [m]`, font: { size: narrow() ? 11 : 13 } }, range: data.ranges[i],
          nticks: ticks(data.ratio[name]), tickfont: { size: narrow() ? 10 : 12 } }])) } });

  function show(index) {
    at = Math.max(0, Math.min(data.moments.length - 1, index));
    const moment = data.moments[at];
    slider.value = at;
    output.textContent = `${moment.time_s.toFixed(1)} s · ${moment.status} · ${moment.belief}`;
    slider.setAttribute("aria-valuetext", output.textContent);
    const away = button => Math.abs(data.moments[Number(button.dataset.moment)].time_s - moment.time_s);
    const nearest = buttons.reduce((best, each) => away(each) < away(best) ? each : best, buttons[0]);
    for (const button of buttons) button.setAttribute("aria-pressed", String(button === nearest));
    if (seen) {
      seen.querySelector("img").src = moment.image;
      seen.querySelector("figcaption").textContent = `Image at ${moment.time_s.toFixed(1)} s` +
        (moment.inliers === undefined ? "" : `, ${moment.inliers} landmarks agree`);
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
  await new Promise(done => requestAnimationFrame(() => setTimeout(done)));  // text is painted before figures are made
  const data = JSON.parse(await unpacked("data"));
  const script = document.createElement("script");
  script.textContent = await unpacked("plotly");
  document.head.append(script);
  const draw = element => {
    const content = data[element.dataset.figure];
    return content.moments ? scene(element, content) : figure(element.querySelector(".plot"), content);
  };
  // What is on the screen first; other figures when they come near it, or before the page is printed.
  const waiting = new Set(figures);
  const watch = new IntersectionObserver(entries => entries.filter(each => each.isIntersecting).forEach(each => drawOnce(each.target)),
    { rootMargin: "50%" });
  const drawOnce = element => {
    watch.unobserve(element);
    return waiting.delete(element) ? draw(element) : null;
  };
  const seen = element => element.getBoundingClientRect().top < window.innerHeight;
  for (const element of [...figures].filter(seen)) await drawOnce(element);
  for (const element of waiting) watch.observe(element);
  addEventListener("beforeprint", () => [...waiting].forEach(drawOnce));
  document.documentElement.dataset.ready = "yes";
})();
