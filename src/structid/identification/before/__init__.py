"""What a look at model and record tells before anything is fitted: mesh, resonances, channels."""
