"""The diagnosis that measures its noise: rows, chain, scales, search, comparison, size, verdict."""
