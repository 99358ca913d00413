(() => {
  const waiting = new Set(document.querySelectorAll(".plot")), near = [], groups = {};
  const draw = place => {
    if (!waiting.delete(place)) return;
    const given = JSON.parse(place.nextElementSibling.textContent);
    Plotly.newPlot(place, given.data, given.layout, {displayModeBar: false, responsive: true});
    const {linked, group} = given.layout.meta || {};
    if (linked) link(place, linked);
    if (group) join(place, groups[group] ||= {places: [], span: {}, hidden: []});
  };
  // Figures of a group show the same stretch of time and hide the same names.
  const join = (place, group) => {
    if (Object.keys(group.span).length) Plotly.relayout(place, group.span);
    for (const [change, traces] of group.hidden) Plotly.restyle(place, change, traces);
    group.places.push(place);
    const tell = async (what, ...change) => {
      if (group.telling) return;
      group.telling = true;
      for (const other of group.places) if (other !== place) await Plotly[what](other, ...change);
      group.telling = false;
    };
    place.on("plotly_relayout", change => {
      const span = Object.fromEntries(Object.entries(change).filter(([name]) => name[0] === "x"));
      if (!Object.keys(span).length || group.telling) return;
      group.span = span;
      tell("relayout", span);
    });
    place.on("plotly_restyle", ([change, traces]) => {
      if (!group.telling) group.hidden.push([change, traces]);
      tell("restyle", change, traces);
    });
  };
  // Of every so many traces the first and the last show the same rows, selected together.
  const link = (place, every) => {
    const mark = event => {
      const rows = {};
      for (const p of (event && event.points) || []) {
        const k = p.curveNumber;
        if (k % every !== 1) (rows[Math.floor(k / every)] ||= new Set()).add(p.pointNumber);
      }
      const none = Object.keys(rows).length === 0;
      const marked = place.data.map((_, k) => none ? null : [...(rows[Math.floor(k / every)] || [])]);
      const shown = marked.map((own, k) => k % every === 1 ? null : own);
      Plotly.restyle(place, {selectedpoints: shown});
    };
    place.on("plotly_selected", mark);
    place.on("plotly_deselect", () => mark());
  };
  const next = () => {
    draw(near.shift());
    if (near.length) setTimeout(next, 30);
  };
  const seen = new IntersectionObserver(entries => {
    const come = entries.filter(entry => entry.isIntersecting).map(entry => entry.target);
    come.forEach(place => seen.unobserve(place));
    if (near.push(...come) === come.length && come.length) setTimeout(next);
  }, {rootMargin: "100%"});
  addEventListener("beforeprint", () => {
    document.querySelectorAll("details").forEach(part => { part.open = true; });
    [...waiting].forEach(draw);
  });
  waiting.forEach(place => seen.observe(place));
})();
