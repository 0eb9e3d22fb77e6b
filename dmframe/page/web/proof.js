// Checks the certificate in this page by a program that shares nothing with the page or with dmframe (`check.js`).
// The content security policy allows that program by its hash.

const LONG = 1e5; // a longer certificate is checked on request, because its check would block the page for a second

async function prove(place) {
  const read = async (id) => new TextDecoder().decode(await unpacked(document.getElementById(id).textContent));
  const file = await read("certificate"), program = await read("checker");
  const button = node("button", "Check the proof", { className: "small" });
  button.onclick = () => {
    document.head.append(node("script", program));
    place.replaceChildren(proofOf(checker.check(JSON.parse(file))));
  };
  place.hidden = false;
  if (file.length > LONG) place.append(button);
  else setTimeout(button.onclick);
}

function node(kind, textContent, more) {
  return Object.assign(document.createElement(kind), { textContent, ...more });
}

function proofOf({ status, reason, conclusions, not_checked: open, robot, assumed, statement, points, log2_error: error }) {
  if (status !== "re-proved") return node("p", `The certificate in this page is ${status}: ${reason}`);
  const all = node("details");
  all.append(node("summary", `Proved again in this browser by an independent program: the identity of ${statement} ` +
    `at ${points} random points, with an error below 2^${error}, and ${conclusions.length} conclusions; ${open.length} were not checked, and ${assumed.length} statements are assumed`));
  for (const [title, lines] of Object.entries({ Conclusions: [...robot, ...conclusions], "Not checked": open, Assumed: assumed })) {
    const list = node("ul");
    list.append(...lines.map((x) => node("li", x)));
    all.append(node("p", title), list);
  }
  return all;
}

if (document.getElementById("certificate").textContent) prove(document.getElementById("proof"));
