// Checks the certificate in this page by a program that shares nothing with the page or with dmframe (`check.js`).
// The content security policy allows that program by its hash.

const LONG = 1e5; // a longer certificate is checked on request, because its check would block the page for a second

async function prove() {
  const [certificate, program] = await Promise.all(["certificate", "checker"].map(async (id) => {
    return new TextDecoder().decode(await unpacked(document.getElementById(id).textContent));
  }));
  const place = document.getElementById("proof"), button = document.createElement("button");
  button.type = "button";
  button.className = "small";
  button.textContent = "Check the proof in this browser";
  button.onclick = () => {
    const script = document.createElement("script");
    script.textContent = program;
    document.head.append(script);
    showProof(place, globalThis.checker?.check(JSON.parse(certificate)));
  };
  place.hidden = false;
  if (certificate.length > LONG) place.append(button);
  else (globalThis.requestIdleCallback ?? setTimeout)(button.onclick);
}

function showProof(place, found) {
  const summary = document.createElement("summary"), parts = document.createElement("details");
  parts.append(summary);
  place.replaceChildren(parts);
  place.dataset.status = found?.status ?? "not run";
  if (found?.status !== "re-proved") {
    summary.textContent = `The certificate in this page is ${found?.status ?? "not checked"}: ${found?.reason ?? "its program did not run"}`;
    return;
  }
  const { conclusions, believed, robot, statement, points, log2_error: error } = found;
  summary.textContent = `Proved again in this browser, by a program that is independent of dmframe: the identity of ${statement} ` +
    `at ${points} random points, with an error below 2^${error}, and ${conclusions.length} conclusions; ${believed.length} statements are believed`;
  for (const [title, lines] of Object.entries({ Conclusions: [...robot, ...conclusions], Believed: believed, Assumed: found.assumed })) {
    const list = document.createElement("ul");
    list.append(...lines.map((line) => Object.assign(document.createElement("li"), { textContent: line })));
    parts.append(Object.assign(document.createElement("p"), { textContent: title }), list);
  }
}

if (document.getElementById("certificate").textContent) prove();
