MODULE Passed
  CONST robtarget pIn:=<24|gripper|table>;
  CONST robtarget pOut:=<25|gripper|table>;
  PROC main()
    Pick pIn,60;
    Pick pOut\Slow,40;
  ENDPROC
  PROC Pick(robtarget pAt,num h,\switch Slow)
    IF Present(Slow) VelSet 50,500;
    MoveJ Offs(pAt,0,0,50),v1000,z10,gripper\WObj:=table;
    MoveL pAt,v100,fine,gripper\WObj:=table;
  ENDPROC
ENDMODULE
