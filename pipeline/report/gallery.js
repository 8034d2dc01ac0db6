// Films: a small canvas for each robot, which plays while it is visible. Those of a figure share scale and waterline.
(() => {
  const { replayAt, drawPane } = robots;
  const shown = (film) => replayAt(Number(film.dataset.replay));
  const films = Array.from(document.querySelectorAll(".film"), (film) => {
    const together = Array.from(film.closest("figure").querySelectorAll(".film"), shown);
    return { canvas: film.querySelector("canvas"), replay: shown(film), together, visible: false };
  });
  const PAUSE = 1; // seconds between the end and the next start
  let playing = false;

  function draw(film, time) {
    const ratio = window.devicePixelRatio || 1, width = film.canvas.clientWidth, height = Math.round(width * 0.5);
    if (film.canvas.width !== Math.round(width * ratio)) {
      film.canvas.width = Math.round(width * ratio);
      film.canvas.height = Math.round(height * ratio);
      film.canvas.style.height = height + "px";
    }
    const context = film.canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    drawPane(context, film.replay, time, { left: 0, top: 0, width, height }, { follow: true, together: film.together });
  }

  function tick(now) {
    const seen = films.filter((film) => film.visible);
    playing = seen.length > 0;
    for (const film of seen) {
      draw(film, Math.min((now / 1000) % (film.replay.duration + PAUSE), film.replay.duration));
    }
    if (playing) requestAnimationFrame(tick);
  }

  const still = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
  const observer = new IntersectionObserver((entries) => {
    for (const entry of entries) {
      const film = films.find((candidate) => candidate.canvas === entry.target);
      film.visible = entry.isIntersecting;
      if (film.visible) draw(film, film.replay.duration / 2);
    }
    if (!still && !playing) { playing = true; requestAnimationFrame(tick); }
  });
  for (const film of films) observer.observe(film.canvas);
})();
