"""Movies without depth as scenes: forces from visual saliency."""
