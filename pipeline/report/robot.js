// Decodes the replay of a robot and draws it into a box of a canvas. Shared by the viewer and the gallery.
"use strict";
const robots = (() => {
  // -- replays --------------------------------------------------------------------------------------------------------

  function bytesOf(text) {
    return Uint8Array.from(atob(text), (character) => character.charCodeAt(0));
  }

  // Undo pipeline/report/replay.py's encode(): poses[frame * 3 * nLinks + 3 * link + (0 x, 1 y, 2 angle)].
  function decode(encoded) {
    const poses = Array.from(new Int16Array(bytesOf(encoded.frames).buffer), (value) => value * encoded.quantum);
    const nLinks = encoded.parent.length, replay = { ...encoded, poses, nLinks, nFrames: poses.length / nLinks / 3 };
    replay.duration = (replay.nFrames - 1) / replay.fps;
    replay.start = poses[0];
    replay.centers = centersOfMass(replay);
    replay.center = smooth(replay.centers, Math.round(replay.fps));
    replay.extent = verticalExtent(replay);
    if (encoded.disagreement) replay.disagreement = { ...encoded.disagreement, levels: bytesOf(encoded.disagreement.levels) };
    return replay;
  }

  // The centre of mass at each frame. Every link has the same mass.
  function centersOfMass(replay) {
    return Array.from({ length: replay.nFrames }, (_, frame) => [0, 1].map((axis) => {
      let sum = 0;
      for (let link = 0; link < replay.nLinks; link++) sum += replay.poses[3 * (frame * replay.nLinks + link) + axis];
      return sum / replay.nLinks;
    }));
  }

  // Points averaged over a window to either side, for the camera to follow.
  function smooth(points, window) {
    const sums = [[0, 0]];
    points.forEach(([x, y], frame) => sums.push([sums[frame][0] + x, sums[frame][1] + y]));
    return points.map((_, frame) => {
      const reach = Math.min(window, frame, points.length - 1 - frame); // equally long on both sides, so that it never lags
      return [0, 1].map((axis) => (sums[frame + reach + 1][axis] - sums[frame - reach][axis]) / (2 * reach + 1));
    });
  }

  // Lowest and highest y of the links, including the surface or the ground where they are near.
  function verticalExtent(replay) {
    let low = Infinity, high = -Infinity;
    for (let i = 0; i < replay.poses.length; i += 3) {
      const reach = Math.abs(Math.cos(replay.poses[i + 2])) * replay.length_scale[(i / 3) % replay.nLinks] / 2;
      low = Math.min(low, replay.poses[i + 1] - reach);
      high = Math.max(high, replay.poses[i + 1] + reach);
    }
    if (replay.has_medium) { low = Math.min(low, -1); high = Math.max(high, 0.5); }
    if (low < -replay.depth + 2) low = Math.min(low, -replay.depth - 0.3);
    return [low - 0.5, high + 0.5];
  }

  // The links at a time, interpolated between frames: [[x, y, angle], ...], and the camera's centre.
  function poseAt(replay, time) {
    const place = Math.min(Math.max(time * replay.fps, 0), replay.nFrames - 1);
    const frame = Math.min(Math.floor(place), replay.nFrames - 2), share = place - frame;
    const mix = (a, b) => a + (b - a) * share;
    const width = 3 * replay.nLinks;
    const value = (i) => mix(replay.poses[frame * width + i], replay.poses[(frame + 1) * width + i]);
    const links = Array.from({ length: replay.nLinks }, (_, i) => [value(3 * i), value(3 * i + 1), value(3 * i + 2)]);
    const between = (points) => [0, 1].map((axis) => mix(points[frame][axis], points[frame + 1][axis]));
    return { frame: Math.round(place), links, center: between(replay.center), mass: between(replay.centers) };
  }

  // The members' disagreement at a frame, as shares of the value of the darkest colour; null where unknown.
  function sharesAt(replay, frame, most) {
    if (!replay.disagreement) return null;
    const levels = replay.disagreement.levels.subarray(frame * replay.nLinks, (frame + 1) * replay.nLinks);
    return Array.from(levels, (level) => (level === 255 ? null : level / 254 * replay.disagreement.most / most));
  }

  // -- colours --------------------------------------------------------------------------------------------------------

  // Cached, because a page that plays twenty robots needs colours thousands of times per second.
  const palette = {};

  function color(name) {
    palette[name] ??= getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
    return palette[name];
  }

  // From pale to dark, which works for colour-blind readers; grey where unknown.
  const HEAT = [[246, 243, 238], [243, 178, 99], [208, 72, 72], [60, 10, 74]];

  function heat(share) {
    if (share === null) return "#9aa2ad";
    const place = Math.min(share, 1) * (HEAT.length - 1), below = Math.min(Math.floor(place), HEAT.length - 2);
    const mixed = HEAT[below].map((part, i) => Math.round(part + (HEAT[below + 1][i] - part) * (place - below)));
    return "rgb(" + mixed.join(", ") + ")";
  }

  // -- drawing --------------------------------------------------------------------------------------------------------

  // Draw a replay at a time into a box of a canvas. Options: follow, caption (with scale), colored (by disagreement), most,
  // and together: the replays in boxes of the same size that have the same scale and waterline.
  function drawPane(context, replay, time, box, options) {
    const { links, center, mass, frame } = poseAt(replay, time);
    const camera = cameraOf(replay, time, box, center, options);
    const surface = camera.y(0), ground = camera.y(-replay.depth);
    context.save();
    context.translate(box.left, box.top);
    context.beginPath();
    context.rect(0, 0, box.width, box.height);
    context.clip();
    context.fillStyle = color("sky");
    context.fillRect(0, 0, box.width, box.height);
    if (replay.has_medium) {
      context.fillStyle = color("slush");
      context.fillRect(0, surface, box.width, Math.max(box.height - surface, 0));
    }
    drawDistances(context, replay, camera, box);
    const shares = options.colored ? sharesAt(replay, frame, options.most) : null;
    drawRobot(context, replay, links, camera, shares);
    if (replay.has_medium && surface < box.height) {
      context.globalAlpha = shares ? 0.12 : 0.45; // colours with a meaning are not dimmed
      context.fillStyle = color("slush");
      context.fillRect(0, surface, box.width, box.height - surface);
      context.globalAlpha = 1;
      context.strokeStyle = color("surface");
      context.lineWidth = 2;
      context.setLineDash(replay.hallucinated ? [10, 6] : []);
      context.beginPath();
      context.moveTo(0, surface);
      context.lineTo(box.width, surface);
      context.stroke();
      context.setLineDash([]);
    }
    if (ground < box.height) {
      context.fillStyle = color("ground");
      context.fillRect(0, ground, box.width, box.height - ground);
      context.fillStyle = color("ground-edge");
      context.fillRect(0, ground - 1, box.width, 2);
    }
    drawCenterOfMass(context, camera.x(mass[0]), camera.y(mass[1]));
    if (options.caption) {
      drawScale(context, replay, camera, box);
      drawCaption(context, replay, links, mass, box);
    }
    context.restore();
  }

  // Metres to canvas. With follow, the robot stays in the middle; otherwise the view spans the robots' paths.
  function cameraOf(replay, time, box, center, options) {
    const together = options.together || [replay];
    const low = Math.min(...together.map((other) => other.extent[0])), high = Math.max(...together.map((other) => other.extent[1]));
    const height = box.height - (options.caption ? 62 : 0);
    let scale = Math.min(height / Math.min(Math.max(high - low, 5), MOST_HEIGHT), box.width / 9);
    let middle = center[0];
    if (!options.follow) {
      const ways = together.map((other) => other.center.map((point) => point[0] - other.start)).flat();
      const from = Math.min(...ways) - 4, to = Math.max(...ways) + 4;
      scale = Math.min(scale, box.width / (to - from));
      middle = replay.start + (from + to) / 2;
    }
    const shown = height / scale;
    let bottom = together.some((other) => low < -other.depth) ? low : (low + high - shown) / 2;
    if (high - low > MOST_HEIGHT) { // follow them up and down
      const heights = together.map((other) => poseAt(other, time).center[1]);
      bottom = Math.max(heights.reduce((sum, y) => sum + y, 0) / heights.length - shown / 2, low);
    }
    return {
      scale,
      x: (x) => box.width / 2 + (x - middle) * scale,
      y: (y) => box.height - (y - bottom) * scale,
      left: middle - box.width / 2 / scale,
      right: middle + box.width / 2 / scale,
    };
  }

  const MOST_HEIGHT = 15; // metres that a view shows from bottom to top

  function drawRobot(context, replay, links, camera, shares) {
    const fill = color(replay.environment ? `arm-${replay.environment}` : "unknown");
    for (let link = replay.nLinks - 1; link >= 0; link--) {
      const [x, y, angle] = links[link];
      const height = replay.length_scale[link] * camera.scale, width = camera.scale / replay.length_scale[link];
      context.save();
      context.translate(camera.x(x), camera.y(y));
      context.rotate(-angle);
      context.beginPath();
      context.roundRect(-width / 2, -height / 2, width, height, 0.22 * width);
      context.fillStyle = shares ? heat(shares[link]) : fill;
      context.fill();
      if (link > 0 && !shares) { context.fillStyle = "rgba(255, 255, 255, 0.28)"; context.fill(); }
      context.strokeStyle = "rgba(0, 0, 0, 0.6)";
      context.lineWidth = 1.5;
      context.stroke();
      context.restore();
    }
    for (let link = 1; link < replay.nLinks; link++) {
      const parent = replay.parent[link], [x, y, angle] = links[parent];
      const along = replay.parent_attachment[link] * replay.length_scale[parent] / 2;
      dot(context, camera.x(x - Math.sin(angle) * along), camera.y(y + Math.cos(angle) * along), 3, "#ffffff", "rgba(0, 0, 0, 0.7)");
    }
    dot(context, camera.x(links[0][0]), camera.y(links[0][1]), 4.5, "#1d2129", "#ffffff");
  }

  // The usual mark of a centre of mass: a disc with dark and light quarters.
  function drawCenterOfMass(context, x, y) {
    const radius = 6;
    dot(context, x, y, radius, "#ffffff", "#1d2129");
    context.fillStyle = "#1d2129";
    for (const from of [0, Math.PI]) {
      context.beginPath();
      context.moveTo(x, y);
      context.arc(x, y, radius, from, from + Math.PI / 2);
      context.fill();
    }
  }

  function dot(context, x, y, radius, fill, edge) {
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

  function drawDistances(context, replay, camera, box) {
    eachDistance(replay, camera, 5, (at, x) => {
      context.fillStyle = color(at === 0 ? "unknown" : "line");
      context.fillRect(x - 0.5, 40, 1, box.height - 40);
    });
  }

  function drawScale(context, replay, camera, box) {
    context.fillStyle = color("ink");
    context.font = "12px system-ui, sans-serif";
    context.textAlign = "center";
    context.textBaseline = "bottom";
    if (camera.scale > 8) eachDistance(replay, camera, 1, (at, x) => context.fillRect(x - 0.5, box.height - 4, 1, 4));
    const every = camera.scale > 8 ? 5 : 20;
    eachDistance(replay, camera, every, (at, x) => {
      context.fillRect(x - 0.5, box.height - 8, 1, 8);
      const label = metres(at, 0), half = context.measureText(label).width / 2;
      if (half <= x && x <= box.width - half) context.fillText(label, x, box.height - 9); // a label that is cut off would be a wrong distance
    });
  }

  function drawCaption(context, replay, links, mass, box) {
    context.textBaseline = "top";
    context.fillStyle = color("ink");
    context.textAlign = "left";
    context.font = "13px system-ui, sans-serif";
    const room = box.width - 96; // beside the displacement; longer text is condensed
    context.fillText("in " + replay.seen_in + ", " + replay.depth + " m", 12, 10, room);
    context.fillStyle = color("soft");
    context.fillText(replay.title, 12, 28, room);
    context.fillStyle = color("ink");
    context.textAlign = "right";
    context.font = "600 18px system-ui, sans-serif";
    context.fillText(metres(links[0][0] - replay.start, 1), box.width - 12, 9);
    context.font = "13px system-ui, sans-serif";
    context.fillStyle = color("soft");
    const moved = metres(mass[0] - replay.centers[0][0], 1);
    context.fillText(box.width < 420 ? moved : "centre of mass " + moved, box.width - 12, 32);
  }

  function metres(value, digits) {
    return value.toFixed(digits).replace(/^-(?=0\.?0*$)/, "").replace("-", "−") + " m";
  }

  // Replays are decoded when they are first shown: a page may hold hundreds.
  const encoded = JSON.parse(document.getElementById("replays").textContent), decoded = [];
  const replayAt = (index) => (decoded[index] ??= decode(encoded[index]));

  return { encoded, replayAt, drawPane, sharesAt, color, heat };
})();
