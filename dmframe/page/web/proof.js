// Checks the certificate in this page by a program that shares nothing with the page or with dmframe (`check.js`).
// The content security policy allows that program by its hash.

const LONG = 1e5; // a longer certificate is checked on request, because its check would block the page for a second

async function prove(place) {
  const read = async (id) => new TextDecoder().decode(await unpacked(document.getElementById(id).textContent));
  const certificate = await read("certificate"), program = await read("checker");
  const button = element("button", "Check the proof in this browser", { type: "button", className: "small" });
  button.onclick = () => {
    document.head.append(element("script", program));
    place.replaceChildren(proofOf(checker.check(JSON.parse(certificate))));
  };
  place.hidden = false;
  if (certificate.length > LONG) place.append(button);
  else setTimeout(button.onclick);
}

function element(kind, textContent, more) {
  return Object.assign(document.createElement(kind), { textContent, ...more });
}

function proofOf({ status, reason, conclusions, believed, robot, assumed, statement, points, log2_error: error }) {
  if (status !== "re-proved") return element("p", `The certificate in this page is ${status}: ${reason}`);
  const all = element("details");
  all.append(element("summary", `Proved again in this browser by a program that is independent of dmframe: the identity of ${statement} ` +
    `at ${points} random points, with an error below 2^${error}, and ${conclusions.length} conclusions; ${believed.length} statements are believed`));
  for (const [title, lines] of Object.entries({ Conclusions: [...robot, ...conclusions], Believed: believed, Assumed: assumed })) {
    const list = element("ul");
    list.append(...lines.map((line) => element("li", line)));
    all.append(element("p", title), list);
  }
  return all;
}

if (document.getElementById("certificate").textContent) prove(document.getElementById("proof"));
