"""One way to keep a run, in a folder or on an object store, and the finished atlas."""
