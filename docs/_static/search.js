"use strict";

// The search of the site. `SEARCH_INDEX` (search_index.js) has one entry for each section and each
// public name: [title of the page, address, heading, prose, code].
//
// An entry is found if each word of the query is in it. A whole word counts before the beginning of
// a word, and that before a part of a word; weaker matches are shown only if there are no better
// ones. Titles count more than headings, headings more than prose, prose more than code.

var WHOLE = 3, BEGINNING = 2, PART = 1;
var FIELDS = [[0, 8], [2, 5], [3, 1], [4, 0.4]]; // index in an entry, weight
var PLACES = [[/^howto\//, 1.3], [/^notebooks\//, 0.6], [/^(errata|verdicts|sources|nasa)/, 0.6]];
var MOST_SECTIONS = 3; // of one page

function wordsOf(text) {
  return text.toLowerCase().replace(/coloured/g, "colored").match(/[\p{L}\p{N}]+/gu) || [];
}

function singular(word) {
  return word.length > 3 && word.endsWith("s") && !word.endsWith("ss") ? word.slice(0, -1) : word;
}

function match(query, word) {
  if (singular(query) === singular(word)) return WHOLE;
  if (query.length > 2 && word.startsWith(query)) return BEGINNING;
  return query.length > 2 && word.includes(query) ? PART : 0;
}

var WORDS = new Map(); // words of the fields of an entry, split once

function fieldsOf(entry) {
  if (!WORDS.has(entry)) {
    WORDS.set(entry, FIELDS.map(function (field) { return [wordsOf(entry[field[0]]), field[1]]; }));
  }
  return WORDS.get(entry);
}

// How well an entry answers: the weakest of its matches, and a score among equals.
function judge(entry, query) {
  var fields = fieldsOf(entry);
  var weakest = WHOLE, score = 0;
  for (var i = 0; i < query.length; i++) {
    var best = 0, points = 0;
    fields.forEach(function (field) {
      var counts = [0, 0, 0, 0];
      field[0].forEach(function (word) { counts[match(query[i], word)]++; });
      var kind = counts[WHOLE] ? WHOLE : counts[BEGINNING] ? BEGINNING : counts[PART] ? PART : 0;
      if (kind > best) { best = kind; points = 0; }
      if (kind && kind === best) points += field[1] * (1 + 0.2 * Math.min(counts[kind] - 1, 5));
    });
    if (!best) return { weakest: 0, score: 0 };
    weakest = Math.min(weakest, best);
    score += points;
  }
  // A title or heading that says nothing else is the better one, and so is a task that begins with it.
  fields.slice(0, 2).forEach(function (field) {
    var hits = field[0].filter(function (word) {
      return query.some(function (part) { return match(part, word) === WHOLE; });
    });
    score += field[1] * hits.length / Math.max(field[0].length, 1);
  });
  var title = fields[0][0], task = /^howto\//.test(entry[1]);
  if (task && title.length && match(query[0], title[0]) === WHOLE) score += 0.3 * fields[0][1];
  var phrase = query.map(singular).join(" ");
  fields.slice(0, 3).forEach(function (field) {
    if (query.length > 1 && field[0].map(singular).join(" ").includes(phrase)) score += 2 * field[1];
  });
  PLACES.forEach(function (place) { if (place[0].test(entry[1])) score *= place[1]; });
  return { weakest: weakest, score: score };
}

// Pages in the order of their best section: [{title, address, sections: [entry, ...]}, ...].
function search(index, text) {
  var query = wordsOf(text), pages = new Map();
  if (!query.length) return [];
  var found = index.map(function (entry, place) {
    var judged = judge(entry, query);
    return { entry: entry, place: place, weakest: judged.weakest, score: judged.score };
  }).filter(function (item) { return item.weakest > 0; });
  var kind = found.reduce(function (best, item) { return Math.max(best, item.weakest); }, 0);
  found = found.filter(function (item) { return item.weakest === kind; });
  found.sort(function (a, b) { return b.score - a.score || a.place - b.place; });
  found.forEach(function (item) {
    var address = item.entry[1].split("#")[0];
    if (!pages.has(address)) {
      pages.set(address, { title: item.entry[0], address: address, sections: [] });
    }
    var sections = pages.get(address).sections;
    if (sections.length < MOST_SECTIONS) sections.push(item.entry);
  });
  return Array.from(pages.values());
}

// A piece of the text around its first match, as [[piece, whether it is marked], ...].
function excerpt(text, query) {
  var words = wordsOf(query), pieces = [], parts = text.split(/([\p{L}\p{N}]+)/u), best = 0, first = -1;
  for (var i = 1; i < parts.length; i += 2) {
    var kind = Math.max.apply(null, words.map(function (word) {
      return match(word, wordsOf(parts[i])[0] || "");
    }));
    if (kind > best) { best = kind; first = i; }
  }
  var start = Math.max(0, first - 24), end = Math.min(parts.length, Math.max(first, 0) + 40);
  if (start > 0) pieces.push(["… ", false]);
  for (i = start; i < end; i++) {
    var marked = i % 2 === 1 && best > 0 && words.some(function (word) {
      return match(word, wordsOf(parts[i])[0] || "") >= best;
    });
    pieces.push([parts[i], marked]);
  }
  if (end < parts.length) pieces.push([" …", false]);
  return pieces;
}

function show(index, text) {
  var list = document.getElementById("search-results"), pages = search(index, text);
  var root = document.documentElement.dataset.content_root || "";
  document.querySelectorAll("input[name=q]").forEach(function (input) { input.value = text; });
  document.getElementById("search-count").textContent = !text.trim() ? ""
    : pages.length === 0 ? "Nothing found. The glossary has other words for many things."
    : pages.length === 1 ? "One page" : pages.length + " pages";
  function add(parent, name, content, address) {
    var node = parent.appendChild(document.createElement(name));
    if (address !== undefined) node.href = root + address;
    content.forEach(function (piece) {
      var into = piece[1] ? node.appendChild(document.createElement("mark")) : node;
      into.append(piece[0]);
    });
    return node;
  }
  pages.forEach(function (page) {
    var item = add(list, "li", []);
    add(add(item, "h2", []), "a", excerpt(page.title, text), page.address);
    page.sections.forEach(function (entry) {
      if (entry[2] !== entry[0]) add(add(item, "h3", []), "a", excerpt(entry[2], text), entry[1]);
      add(item, "p", excerpt(entry[3] || entry[4], text));
    });
  });
}

if (typeof module !== "undefined") {
  module.exports = { search: search, excerpt: excerpt };
} else {
  show(SEARCH_INDEX, new URLSearchParams(location.search).get("q") || "");
}
