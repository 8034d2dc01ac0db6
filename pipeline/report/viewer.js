// The replay viewer: one clock, one canvas, and a pane for each of one or two robots.
(() => {
  const { replays, drawPane, sharesAt, color, heat } = robots;
  const control = (id) => document.getElementById(id);
  const canvas = control("stage"), timeline = control("timeline");
  const state = { panes: [], time: 0, playing: false, speed: 1, before: null };
  const NARROW = 640; // pixels; below this width, two panes are stacked

  // -- drawing --------------------------------------------------------------------------------------------------------

  const duration = () => Math.max(...state.panes.map((replay) => replay.duration));

  // Give a canvas as many pixels as the screen has for it, and a context in CSS pixels.
  function prepare(target, height) {
    const ratio = window.devicePixelRatio || 1, width = target.clientWidth;
    if (target.width !== Math.round(width * ratio) || target.height !== Math.round(height * ratio)) {
      target.width = Math.round(width * ratio);
      target.height = Math.round(height * ratio);
      target.style.height = height + "px";
    }
    const context = target.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    return context;
  }

  function draw() {
    const width = canvas.clientWidth, stacked = width < NARROW && state.panes.length > 1;
    const paneHeight = Math.round(Math.min(420, Math.max(260, width * 0.5))) * (stacked ? 0.85 : 1);
    const context = prepare(canvas, Math.round(paneHeight * (stacked ? state.panes.length : 1)));
    const options = {
      follow: control("follow").checked, caption: true, overlay: control("overlay").value, push: control("push").checked,
    };
    options.most = mostOf(options.overlay);
    state.panes.forEach((replay, index) => {
      const paneWidth = stacked ? width : width / state.panes.length;
      const box = { left: stacked ? 0 : index * paneWidth, top: stacked ? index * paneHeight : 0, width: paneWidth, height: paneHeight };
      drawPane(context, replay, state.time, box, options);
      if (index > 0) {
        context.fillStyle = color("card");
        context.fillRect(box.left - (stacked ? 0 : 2), box.top - (stacked ? 2 : 0), stacked ? width : 4, stacked ? 4 : paneHeight);
      }
    });
    control("scrub").max = duration();
    control("scrub").value = state.time;
    control("time").textContent = state.time.toFixed(1) + " / " + duration().toFixed(1) + " s";
    drawTimeline(options.overlay, options.most);
  }

  // The value of the darkest colour, the same for all robots shown so that they can be compared.
  function mostOf(label) {
    const shown = state.panes.flatMap((replay) => replay.overlays.filter((overlay) => overlay.label === label));
    return Math.max(...shown.map((overlay) => overlay.most), 1e-9);
  }

  // The mean over links of the colours' value, a line for each robot, and the current time.
  function drawTimeline(label, darkest) {
    const shown = state.panes.filter((replay) => replay.overlays.some((overlay) => overlay.label === label));
    control("line").hidden = shown.length === 0;
    if (shown.length === 0) return;
    const context = prepare(timeline, 64), width = timeline.clientWidth, height = 64;
    context.clearRect(0, 0, width, height);
    const lines = shown.map((replay) => meanOverLinks(replay, label, darkest));
    const most = Math.max(...lines.flat().filter((value) => value !== null), 1e-9);
    lines.forEach((line, index) => {
      context.beginPath();
      let drawing = false;
      line.forEach((value, frame) => {
        if (value === null) { drawing = false; return; }
        const x = frame / shown[index].fps / duration() * width, y = height - 4 - value / most * (height - 12);
        if (drawing) context.lineTo(x, y); else context.moveTo(x, y);
        drawing = true;
      });
      context.strokeStyle = color((shown[index].environment || "unknown").replaceAll("_", "-"));
      context.lineWidth = 1.5;
      context.setLineDash(index ? [5, 3] : []);
      context.stroke();
      context.setLineDash([]);
    });
    context.fillStyle = color("ink");
    context.fillRect(state.time / duration() * width - 1, 0, 2, height);
    const ramp = [0, 0.25, 0.5, 0.75, 1].map((share) => heat(share)).join(", ");
    const unit = shown[0].overlays.find((overlay) => overlay.label === label).unit;
    const scale = " " + darkest.toPrecision(2) + " " + unit + " or more. Line: mean over links, up to " + most.toPrecision(2) + " " + unit + ".";
    const which = shown.length > 1 ? " Solid: in " + shown[0].seenIn + "; dashed: in " + shown[1].seenIn + "." : "";
    const legend = control("legend"), text = scale + which;
    if (legend.dataset.text !== text) {
      legend.dataset.text = text;
      legend.replaceChildren("0 ", Object.assign(document.createElement("span"), { className: "ramp" }), text);
      legend.querySelector(".ramp").style.background = "linear-gradient(to right, " + ramp + ")";
    }
  }

  function meanOverLinks(replay, label, most) {
    return Array.from({ length: replay.nFrames }, (_, frame) => {
      const known = sharesAt(replay, label, frame, most).filter((share) => share !== null);
      return known.length ? known.reduce((sum, share) => sum + share, 0) / known.length * most : null;
    });
  }

  // -- time and controls ----------------------------------------------------------------------------------------------

  function tick(now) {
    if (!state.playing) return;
    if (state.before !== null) state.time += (now - state.before) / 1000 * state.speed;
    state.before = now;
    if (state.time >= duration()) { state.time = duration(); play(false); }
    draw();
    requestAnimationFrame(tick);
  }

  function play(on) {
    if (on && state.time >= duration()) state.time = 0;
    state.playing = on;
    state.before = null;
    control("play").textContent = on ? "Pause" : "Play";
    if (on) requestAnimationFrame(tick);
  }

  function seek(time) {
    play(false);
    state.time = Math.min(Math.max(time, 0), duration());
    draw();
  }

  // The same robot in its other environment: where it evolved, or True Slush. Robots from True Slush have none.
  function twinOf(one) {
    return replays.find((other) => other !== one && ["title", "environment", "depth"].every((name) => other[name] === one[name]));
  }

  function choose() {
    const one = replays[Number(control("choice").value)], beside = control("beside").value;
    const other = beside === "twin" ? twinOf(one) : beside && replays[Number(beside)];
    state.panes = other ? [one, other] : [one];
    state.time = 0;
    draw();
  }

  control("choice").addEventListener("change", choose);
  control("beside").addEventListener("change", choose);
  control("play").addEventListener("click", () => play(!state.playing));
  control("scrub").addEventListener("input", (event) => seek(Number(event.target.value)));
  control("speed").addEventListener("change", (event) => { state.speed = Number(event.target.value); });
  for (const id of ["follow", "overlay", "push"]) control(id).addEventListener("change", draw);
  const seekOnLine = (event) => {
    if (event.buttons) seek(event.offsetX / timeline.clientWidth * duration());
  };
  timeline.addEventListener("pointerdown", seekOnLine);
  timeline.addEventListener("pointermove", seekOnLine);
  window.addEventListener("resize", draw);
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  for (const film of document.querySelectorAll(".film")) {
    film.addEventListener("click", () => {
      control("choice").value = film.dataset.replay;
      choose();
      control("viewer").scrollIntoView({ block: "center" });
      play(true);
    });
  }

  choose();
})();
