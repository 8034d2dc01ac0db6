// The replay viewer: one clock, one canvas, and a pane for each of one or two robots.
(() => {
  const { encoded, replayAt, drawPane, sharesAt, color, heat } = robots;
  const control = (id) => document.getElementById(id);
  const choice = control("choice"), beside = control("beside"); // missing on the page of a single robot
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
      follow: control("follow").checked, caption: true, colored: control("disagreement").checked, together: state.panes,
    };
    options.most = darkest();
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
    drawTimeline(options.colored, options.most);
  }

  // The value of the darkest colour, the same for all robots shown so that they can be compared.
  function darkest() {
    return Math.max(...state.panes.map((replay) => replay.disagreement?.most ?? 0), 1e-9);
  }

  // The mean disagreement over links, a line for each robot, and the current time.
  function drawTimeline(colored, darkest) {
    const shown = state.panes.filter((replay) => colored && replay.disagreement);
    control("line").hidden = shown.length === 0;
    if (shown.length === 0) return;
    const context = prepare(timeline, 64), width = timeline.clientWidth, height = 64;
    context.clearRect(0, 0, width, height);
    const lines = shown.map((replay) => meanOverLinks(replay, darkest));
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
      context.strokeStyle = color(shown[index].environment ? `arm-${shown[index].environment}` : "unknown");
      context.lineWidth = 1.5;
      context.setLineDash(index ? [5, 3] : []);
      context.stroke();
      context.setLineDash([]);
    });
    context.fillStyle = color("ink");
    context.fillRect(state.time / duration() * width - 1, 0, 2, height);
    const ramp = [0, 0.25, 0.5, 0.75, 1].map((share) => heat(share)).join(", ");
    const scale = " " + darkest.toPrecision(2) + " m/s² or more. Line: mean over links, up to " + most.toPrecision(2) + " m/s².";
    const which = shown.length > 1 ? " Solid: in " + shown[0].seen_in + "; dashed: in " + shown[1].seen_in + "." : "";
    const legend = control("legend"), text = scale + which;
    if (legend.dataset.text !== text) {
      legend.dataset.text = text;
      legend.replaceChildren("0 ", Object.assign(document.createElement("span"), { className: "ramp" }), text);
      legend.querySelector(".ramp").style.background = "linear-gradient(to right, " + ramp + ")";
    }
  }

  function meanOverLinks(replay, most) {
    return Array.from({ length: replay.nFrames }, (_, frame) => {
      const known = sharesAt(replay, frame, most).filter((share) => share !== null);
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

  // The same robot in its other environment: where it evolved, or the target. Robots from the target have none.
  function twinOf(index) {
    const replay = encoded[index], same = (other) => ["robot", "title", "environment", "depth"].every((name) => other[name] === replay[name]);
    return encoded.findIndex((other) => other !== replay && same(other));
  }

  let wantsTwin = true; // until the reader compares with something else

  function choose() {
    const index = choice ? Number(choice.value) : 0, twin = twinOf(index);
    if (beside) {
      beside.querySelector("[value=twin]").disabled = twin < 0;
      if (beside.value === "twin" && twin < 0) beside.value = "";
      if (wantsTwin && twin >= 0) beside.value = "twin";
    }
    const other = beside?.value === "twin" ? twin : beside?.value ? Number(beside.value) : -1;
    state.panes = [index, ...(other < 0 ? [] : [other])].map(replayAt);
    control("disagreement").disabled = !state.panes.some((replay) => replay.disagreement);
    state.time = 0;
    showRobot(encoded[index]);
    draw();
  }

  // -- the robot's address, files and commands ------------------------------------------------------------------------

  // The folder of the page and of its store, where it is still in that store's folder; "" elsewhere.
  const here = location.protocol === "file:" ? decodeURIComponent(location.pathname).replace(/[^/]*$/, "") : "";
  const store = here.match(/^(.*)\/studies\/[^/]+\/report\/$/)?.[1];
  const quoted = (word) => (/^[\w@%+=:,./-]+$/.test(word) ? word : "'" + word.replaceAll("'", "'\\''") + "'");

  function showRobot(replay) {
    const files = control("robot");
    if (!files) return;
    files.hidden = !replay.robot;
    control("design").href = replay.robot + ".json";
    control("address").href = "#" + replay.robot;
    for (const code of files.querySelectorAll("[data-command]")) {
      const words = { file: here + replay.robot + ".json", seen: replay.command, depth: replay.depth, store: store || "store" };
      code.parentElement.hidden = !replay.command && code.dataset.command.includes("{seen}");
      code.textContent = code.dataset.command.replace(/\{(\w+)\}/g, (_, name) => quoted(String(words[name])));
    }
  }

  async function copy(button) {
    const code = button.parentElement.querySelector("code");
    try {
      await navigator.clipboard.writeText(code.textContent);
      button.textContent = "Copied";
    } catch { // refused, or a browser without a clipboard: the reader copies the selection
      getSelection().selectAllChildren(code);
      button.textContent = "Selected";
    }
    setTimeout(() => { button.textContent = "Copy"; }, 2000);
  }

  for (const button of document.querySelectorAll(".copy")) button.addEventListener("click", () => copy(button));

  // Open the robot that the address of the page names, in the target or, after a colon, as the networks predict it.
  function openAddressed() {
    const [robot, predicted] = decodeURIComponent(location.hash).slice(1).split(":");
    const named = encoded.filter((replay) => replay.robot && replay.robot === robot);
    if (!named.length || !choice) return;
    const replay = (predicted && named.find(({ hallucinated }) => hallucinated)) || named[0];
    choice.value = String(encoded.indexOf(replay));
    choose();
    control("viewer").scrollIntoView({ block: "center" });
  }

  window.addEventListener("hashchange", openAddressed);

  function chosen() {
    choose();
    const { robot } = encoded[choice.value];
    if (robot && location.protocol !== "about:") history.replaceState(null, "", "#" + robot);
  }

  choice?.addEventListener("change", chosen);
  beside?.addEventListener("change", () => {
    wantsTwin = beside.value === "twin";
    choose();
  });
  control("play").addEventListener("click", () => play(!state.playing));
  control("scrub").addEventListener("input", (event) => seek(Number(event.target.value)));
  control("speed").addEventListener("change", (event) => { state.speed = Number(event.target.value); });
  for (const id of ["follow", "disagreement"]) control(id).addEventListener("change", draw);
  const seekOnLine = (event) => {
    if (event.buttons) seek(event.offsetX / timeline.clientWidth * duration());
  };
  timeline.addEventListener("pointerdown", seekOnLine);
  timeline.addEventListener("pointermove", seekOnLine);
  new ResizeObserver(draw).observe(canvas); // also when a frame around the page appears, as in MLflow
  for (const film of document.querySelectorAll(".film")) {
    film.addEventListener("click", () => {
      if (choice) {
        choice.value = film.dataset.replay;
        chosen();
      }
      control("viewer").scrollIntoView({ block: "center" });
      play(true);
    });
  }

  choose();
  openAddressed();
})();
