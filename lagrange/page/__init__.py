"""HTML pages: one with sliders that computes the motion of a system in JavaScript, and one that plays a recorded run.

Scripts, style sheets and HTML templates of both pages are in `template/`: `motion.js` computes the motion, `picture.js`
draws it, and `page.js` plays and pauses it.
"""
