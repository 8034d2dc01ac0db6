// The replay viewer: one clock, one canvas, and a pane for each robot shown. A pane is a replay and the rectangle of the
// canvas that it is drawn in, so showing two robots side by side is a matter of putting two panes into `panes`.
"use strict";
(() => {
  const replays = JSON.parse(document.getElementById("replays").textContent).map(decode);
  const canvas = document.getElementById("stage");
  const context = canvas.getContext("2d");
  const control = (id) => document.getElementById(id);
  const state = { panes: [], time: 0, playing: false, speed: 1, follow: true, before: null };

  // -- replays --------------------------------------------------------------------------------------------------------

  // Undo pipeline/report/replay.py's encode(): poses[frame * 3 * nLinks + 3 * link + (0 x, 1 y, 2 angle)].
  function decode(encoded) {
    const bytes = Uint8Array.from(atob(encoded.steps), (character) => character.charCodeAt(0));
    const view = new DataView(bytes.buffer);
    const width = encoded.first.length;
    const poses = new Float64Array(width + bytes.length / 2);
    const quanta = encoded.first.slice();
    for (let i = 0; i < poses.length; i++) {
      if (i >= width) quanta[i % width] += view.getInt16(2 * (i - width), true);
      poses[i] = quanta[i % width] * encoded.quantum;
    }
    const replay = { ...encoded, poses, nLinks: width / 3, nFrames: poses.length / width };
    replay.duration = (replay.nFrames - 1) / replay.fps;
    replay.start = poses[0];
    replay.center = smoothCenter(replay);
    replay.extent = verticalExtent(replay);
    return replay;
  }

  // The way of the whole robot's centre, evened out over a second either way, for the camera to follow.
  function smoothCenter(replay) {
    const window = Math.round(replay.fps);
    const sums = [[0, 0]];
    for (let frame = 0; frame < replay.nFrames; frame++) {
      let x = 0, y = 0;
      for (let link = 0; link < replay.nLinks; link++) {
        x += replay.poses[3 * (frame * replay.nLinks + link)] / replay.nLinks;
        y += replay.poses[3 * (frame * replay.nLinks + link) + 1] / replay.nLinks;
      }
      sums.push([sums[frame][0] + x, sums[frame][1] + y]);
    }
    return Array.from({ length: replay.nFrames }, (_, frame) => {
      const reach = Math.min(window, frame, replay.nFrames - 1 - frame); // the same to either side, so it never lags
      return [0, 1].map((axis) => (sums[frame + reach + 1][axis] - sums[frame - reach][axis]) / (2 * reach + 1));
    });
  }

  // Lowest and highest y that the links reach, with the surface or the ground where they are near.
  function verticalExtent(replay) {
    let low = Infinity, high = -Infinity;
    for (let i = 0; i < replay.poses.length; i += 3) {
      const reach = Math.abs(Math.cos(replay.poses[i + 2])) * replay.lengthScale[(i / 3) % replay.nLinks] / 2;
      low = Math.min(low, replay.poses[i + 1] - reach);
      high = Math.max(high, replay.poses[i + 1] + reach);
    }
    if (replay.hasMedium) { low = Math.min(low, -1); high = Math.max(high, 0.5); }
    if (low < -replay.depth + 2) low = Math.min(low, -replay.depth - 0.3);
    return [low - 0.5, high + 0.5];
  }

  // Where the links are at a time, between frames: [[x, y, angle], ...], and the camera's centre.
  function poseAt(replay, time) {
    const place = Math.min(Math.max(time * replay.fps, 0), replay.nFrames - 1);
    const frame = Math.min(Math.floor(place), replay.nFrames - 2), share = place - frame;
    const mix = (a, b) => a + (b - a) * share;
    const width = 3 * replay.nLinks;
    const value = (i) => mix(replay.poses[frame * width + i], replay.poses[(frame + 1) * width + i]);
    const links = Array.from({ length: replay.nLinks }, (_, i) => [value(3 * i), value(3 * i + 1), value(3 * i + 2)]);
    return { links, center: [0, 1].map((axis) => mix(replay.center[frame][axis], replay.center[frame + 1][axis])) };
  }

  // -- drawing --------------------------------------------------------------------------------------------------------

  function color(name) {
    return getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
  }

  function draw() {
    const ratio = window.devicePixelRatio || 1;
    const width = canvas.clientWidth, height = Math.round(Math.min(420, Math.max(260, width * 0.5)));
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
      canvas.style.height = height + "px";
    }
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    state.panes.forEach((replay, index) => {
      const paneWidth = width / state.panes.length;
      drawPane(replay, { left: index * paneWidth, width: paneWidth, height });
    });
    const duration = Math.max(...state.panes.map((replay) => replay.duration));
    control("scrub").max = duration;
    control("scrub").value = state.time;
    control("time").textContent = state.time.toFixed(1) + " / " + duration.toFixed(1) + " s";
  }

  function drawPane(replay, box) {
    const { links, center } = poseAt(replay, state.time);
    const camera = cameraOf(replay, box, center);
    const surface = camera.y(0), ground = camera.y(-replay.depth);
    context.save();
    context.beginPath();
    context.rect(box.left, 0, box.width, box.height);
    context.clip();
    context.fillStyle = color("sky");
    context.fillRect(box.left, 0, box.width, box.height);
    if (replay.hasMedium) {
      context.fillStyle = color("slush");
      context.fillRect(box.left, surface, box.width, Math.max(box.height - surface, 0));
    }
    drawDistances(replay, camera, box);
    drawRobot(replay, links, camera);
    if (replay.hasMedium && surface < box.height) {
      context.globalAlpha = 0.45;
      context.fillStyle = color("slush");
      context.fillRect(box.left, surface, box.width, box.height - surface);
      context.globalAlpha = 1;
      context.fillStyle = color("surface");
      context.fillRect(box.left, surface - 1, box.width, 2);
    }
    if (ground < box.height) {
      context.fillStyle = color("ground");
      context.fillRect(box.left, ground, box.width, box.height - ground);
      context.fillStyle = color("ground-edge");
      context.fillRect(box.left, ground - 1, box.width, 2);
    }
    drawScale(replay, camera, box);
    drawCaption(replay, links, box);
    context.restore();
  }

  // World to canvas. Following, it keeps the robot in the middle; otherwise it shows the whole way from start to end.
  function cameraOf(replay, box, center) {
    const [low, high] = replay.extent;
    const caption = 52;
    let scale = Math.min((box.height - caption) / Math.max(high - low, 5), box.width / 9);
    let middle = center[0];
    if (!state.follow) {
      const ways = replay.center.map((point) => point[0]);
      const from = Math.min(...ways) - 4, to = Math.max(...ways) + 4;
      scale = Math.min(scale, box.width / (to - from));
      middle = (from + to) / 2;
    }
    const shown = (box.height - caption) / scale;
    let bottom = (low + high - shown) / 2;
    if (low < -replay.depth) bottom = low;
    if (high - low > 15) {
      scale = (box.height - caption) / 15;
      bottom = Math.max(center[1] - 7.5, low);
    }
    return {
      scale,
      x: (x) => box.left + box.width / 2 + (x - middle) * scale,
      y: (y) => box.height - (y - bottom) * scale,
      left: middle - box.width / 2 / scale,
      right: middle + box.width / 2 / scale,
    };
  }

  function drawRobot(replay, links, camera) {
    const fill = color((replay.environment || "unknown").replace("_", "-"));
    for (let link = replay.nLinks - 1; link >= 0; link--) {
      const [x, y, angle] = links[link];
      const height = replay.lengthScale[link] * camera.scale, width = camera.scale / replay.lengthScale[link];
      context.save();
      context.translate(camera.x(x), camera.y(y));
      context.rotate(-angle);
      context.beginPath();
      context.roundRect(-width / 2, -height / 2, width, height, 0.22 * width);
      context.fillStyle = fill;
      context.fill();
      if (link > 0) { context.fillStyle = "rgba(255, 255, 255, 0.28)"; context.fill(); }
      context.strokeStyle = "rgba(0, 0, 0, 0.6)";
      context.lineWidth = 1.5;
      context.stroke();
      context.restore();
    }
    for (let link = 1; link < replay.nLinks; link++) {
      const parent = replay.parent[link], [x, y, angle] = links[parent];
      const along = replay.parentAttachment[link] * replay.lengthScale[parent] / 2;
      dot(camera.x(x - Math.sin(angle) * along), camera.y(y + Math.cos(angle) * along), 3, "#ffffff", "rgba(0, 0, 0, 0.7)");
    }
    dot(camera.x(links[0][0]), camera.y(links[0][1]), 4.5, "#1d2129", "#ffffff");
  }

  function dot(x, y, radius, fill, edge) {
    context.beginPath();
    context.arc(x, y, radius, 0, 2 * Math.PI);
    context.fillStyle = fill;
    context.fill();
    context.strokeStyle = edge;
    context.lineWidth = 1.5;
    context.stroke();
  }

  function eachDistance(replay, camera, every, mark) {
    const from = Math.ceil((camera.left - replay.start) / every), to = Math.floor((camera.right - replay.start) / every);
    for (let number = from; number <= to; number++) mark(number * every, camera.x(replay.start + number * every));
  }

  function drawDistances(replay, camera, box) {
    eachDistance(replay, camera, 5, (at, x) => {
      context.fillStyle = color(at === 0 ? "unknown" : "line");
      context.fillRect(x - 0.5, 40, 1, box.height - 40);
    });
  }

  function drawScale(replay, camera, box) {
    context.fillStyle = color("ink");
    context.font = "12px system-ui, sans-serif";
    context.textAlign = "center";
    context.textBaseline = "bottom";
    if (camera.scale > 8) eachDistance(replay, camera, 1, (at, x) => context.fillRect(x - 0.5, box.height - 4, 1, 4));
    const every = camera.scale > 8 ? 5 : 20;
    eachDistance(replay, camera, every, (at, x) => {
      context.fillRect(x - 0.5, box.height - 8, 1, 8);
      context.fillText(metres(at, 0), x, box.height - 9);
    });
  }

  function drawCaption(replay, links, box) {
    context.textBaseline = "top";
    context.fillStyle = color("ink");
    context.textAlign = "left";
    context.font = "13px system-ui, sans-serif";
    context.fillText("in " + replay.world + ", " + replay.depth + " m", box.left + 12, 12);
    context.textAlign = "right";
    context.font = "600 18px system-ui, sans-serif";
    context.fillText(metres(links[0][0] - replay.start, 1), box.left + box.width - 12, 9);
  }

  function metres(value, digits) {
    return value.toFixed(digits).replace(/^-(?=0\.?0*$)/, "").replace("-", "−") + " m";
  }

  // -- time and controls ----------------------------------------------------------------------------------------------

  function tick(now) {
    if (!state.playing) return;
    const duration = Math.max(...state.panes.map((replay) => replay.duration));
    if (state.before !== null) state.time += (now - state.before) / 1000 * state.speed;
    state.before = now;
    if (state.time >= duration) { state.time = duration; play(false); }
    draw();
    requestAnimationFrame(tick);
  }

  function play(on) {
    const duration = Math.max(...state.panes.map((replay) => replay.duration));
    if (on && state.time >= duration) state.time = 0;
    state.playing = on;
    state.before = null;
    control("play").textContent = on ? "Pause" : "Play";
    if (on) requestAnimationFrame(tick);
  }

  control("choice").addEventListener("change", (event) => {
    state.panes = [replays[Number(event.target.value)]];
    state.time = 0;
    draw();
  });
  control("play").addEventListener("click", () => play(!state.playing));
  control("scrub").addEventListener("input", (event) => { play(false); state.time = Number(event.target.value); draw(); });
  control("speed").addEventListener("change", (event) => { state.speed = Number(event.target.value); });
  control("follow").addEventListener("change", (event) => { state.follow = event.target.checked; draw(); });
  window.addEventListener("resize", draw);
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);

  state.panes = [replays[Number(control("choice").value)]];
  draw();
})();
