"""What rendering is made of: parallelograms, their paint, the light that falls on them, rays, and a camera's sensor."""
