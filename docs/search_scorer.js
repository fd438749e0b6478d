// Keys of scenario files first, the shortest foremost; then metrics, terms and names of a script; internals and history last.
var Scorer = {
  objNameMatch: 11, objPartialMatch: 6, objPrio: { 0: 15, 1: 5, 2: -5 }, objPrioDefault: 0,
  title: 15, partialTitle: 7, term: 5, partialTerm: 2,
  score: ([page, title, , , score, , kind]) => {
    const isNamed = kind === "object" && score >= 16;  // the last part of the name is the word that is looked for
    if (page === "reference/keys" && isNamed) return 100 - title.split(".").length;
    if (page === "reference/metrics" && isNamed) return 80;
    if (kind === "index") return Math.min(score, 50);  // a term of the glossary
    if (page === "reference/keys") return score - 2;
    if (page === "changelog" || page === "contributing") return score - 15;
    if (page === "reference/api/kernel" || page === "reference/api/testing") return score - 12;
    return page.startsWith("reference/api/") ? score - 6 : score;
  },
};
