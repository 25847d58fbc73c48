"""What every node has: parameters, the sample path past the middleware, and what it knows of the others."""
