"""Third-party matchers as localizers: matches are lifted to map points, and PnP gives a pose."""
