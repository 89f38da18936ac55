"""The store: objects by key in a folder or a bucket, blobs by content, packs of many small files."""
