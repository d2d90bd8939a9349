"""The arm in the browser: the page that `rust/web/build` makes, and who serves it."""
