"""A page whose own frames show no splats, as its pictures do: for tests that look at these."""

UNSEEN = """
const draw = WebGL2RenderingContext.prototype.drawArraysInstanced;
WebGL2RenderingContext.prototype.drawArraysInstanced = function drawn(...values) {
  if (this.getParameter(this.FRAMEBUFFER_BINDING)) draw.apply(this, values);
};
"""
"""Splats are drawn for pictures alone, which are no frames of the page.

Without a graphics card that takes half a second for each of them.
"""
