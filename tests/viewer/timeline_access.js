// What a page lacks for people who see little or nothing: texts of low contrast, controls without a name, and a page that is
// wider than the window.
(() => {
  const numbers = (colour) => (colour.match(/[\d.]+/g) ?? []).map(Number);
  const luminance = ([r, g, b]) => [r, g, b].map((v) => v / 255).map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)).reduce((sum, v, n) => sum + v * [0.2126, 0.7152, 0.0722][n], 0);
  const groundOf = (element) => {
    for (let e = element; e; e = e.parentElement) {
      const colour = numbers(getComputedStyle(e).backgroundColor);
      if (colour.length === 3 || colour[3] === 1) return colour;
    }
    return [255, 255, 255];
  };
  const isShown = (element) => element.checkVisibility() && !element.classList.contains("hidden") && !element.disabled;
  const faint = [];
  for (const element of document.querySelectorAll("body *")) {
    const hasText = [...element.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim());
    if (!hasText || !isShown(element) || /^(SCRIPT|NOSCRIPT|OPTION)$/.test(element.tagName)) continue;
    const [a, b] = [luminance(numbers(getComputedStyle(element).color)), luminance(groundOf(element))];
    const contrast = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    if (contrast < 4.5) faint.push([element.outerHTML.slice(0, 80), contrast]);
  }
  const nameOf = (e) => e.getAttribute("aria-label") || e.labels?.[0]?.textContent || (e.getAttribute("aria-labelledby") && document.getElementById(e.getAttribute("aria-labelledby")).textContent) || e.textContent;
  const controls = [...document.querySelectorAll("button, input, select, meter, [tabindex], [role=img]")].filter(isShown);
  const small = controls.filter((e) => e.getBoundingClientRect().height < 24 && /^(BUTTON|INPUT|SELECT)$/.test(e.tagName));
  return { faint, unnamed: controls.filter((e) => !nameOf(e).trim()).map((e) => e.outerHTML.slice(0, 80)), small: small.map((e) => e.id || e.outerHTML), controls: controls.length, excess: document.documentElement.scrollWidth - innerWidth };
})()
