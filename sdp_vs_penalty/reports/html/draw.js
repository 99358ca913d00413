(async () => {
  // Scripts and figures are kept compressed: four times smaller.
  const unpack = async place => {
    const bytes = Uint8Array.from(atob(place.textContent), letter => letter.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Response(stream).text();
  };
  const waiting = new Set(document.querySelectorAll(".plot")), near = [], groups = {};
  const given_of = new Map();
  const draw = place => {
    if (!waiting.delete(place)) return;
    const given = given_of.get(place);
    Plotly.newPlot(place, given.data, given.layout, {displayModeBar: false, responsive: true});
    const {group} = given.layout.meta || {};
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
  const script = document.createElement("script");
  script.textContent = await unpack(document.getElementById("plotly"));
  document.head.append(script);
  for (const place of waiting) given_of.set(place, JSON.parse(await unpack(place.nextElementSibling)));
  waiting.forEach(place => seen.observe(place));
  document.body.dataset.ready = "";
})();
